import sys

import pytest

from geoevs.core import plugins
from geoevs.core.errors import GeoEvsError, did_you_mean
from geoevs.core.plugins import check_imports, find_plugins, load_plugin, one_sentence
from geoevs.core.settings import check_options


@pytest.fixture
def packages(tmp_path, monkeypatch):
    """Two packages of plugins: `one` has a-b and broken, `two` has classless."""
    for package, folder, text in [
        ("one", "a_b", "class Method:\n    pass\n"),
        ("one", "broken", "raise RuntimeError('imported')\n"),
        ("two", "classless", ""),
    ]:
        (tmp_path / package / folder).mkdir(parents=True)
        (tmp_path / package / folder / "adapter.py").write_text(text)
    (tmp_path / "one" / "no_plugin").mkdir()
    (tmp_path / "one" / "adapter.py").write_text("")
    monkeypatch.syspath_prepend(tmp_path)
    yield find_plugins("adapter", "no.group", "one", "two")
    for name in [name for name in sys.modules if name.split(".")[0] in ("one", "two")]:
        del sys.modules[name]


def test_plugins_are_folders_with_the_file_and_are_not_imported(packages):
    assert packages == {
        "a-b": "one.a_b.adapter",
        "broken": "one.broken.adapter",
        "classless": "two.classless.adapter",
    }


@pytest.mark.parametrize("folder", ["a_b", "a-b"])
def test_two_folders_of_one_name_are_refused(packages, tmp_path, folder):
    (tmp_path / "two" / folder).mkdir()
    (tmp_path / "two" / folder / "adapter.py").write_text("")
    sentence = f"^{tmp_path}/two/{folder} has the name 'a-b', as one/a_b has; rename one folder$"
    with pytest.raises(GeoEvsError, match=sentence):
        find_plugins("adapter", "no.group", "one", "two")


def test_whatever_a_module_raises_becomes_one_sentence(packages):
    sentence = r"^one/broken/adapter.py cannot be read \(RuntimeError: imported\); mend it$"
    with pytest.raises(GeoEvsError, match=sentence), one_sentence("one/broken/adapter.py"):
        load_plugin("method", "broken", packages, "Method")


@pytest.mark.parametrize(
    ("line", "what"),
    [
        ("import os; os._exit(0)", "ends"),
        ("import os; os.kill(os.getpid(), 9)", "ends"),
        ("import time; time.sleep(600)", "occupies for more than 2 s"),
        ("input(); raise ValueError; print('said')", None),
        ("import sys; sys.exit(3)", None),
        ("import os; os.write(1, b'said')", None),
    ],
)
def test_what_ends_its_process_when_imported_is_named(
    packages, tmp_path, monkeypatch, capfd, line, what
):
    (tmp_path / "two" / "last").mkdir()
    (tmp_path / "two" / "last" / "adapter.py").write_text(line)
    monkeypatch.setattr(plugins, "IMPORT_SECONDS", 2.0)
    modules = [*packages.values(), "two.last.adapter"]
    if what is None:
        check_imports(modules)
    else:
        with pytest.raises(GeoEvsError, match=f"^two/last/adapter.py {what} the process that impo"):
            check_imports(modules)
    assert capfd.readouterr() == ("", "")
    assert not sys.modules.keys() & set(modules)


def test_loading_gives_the_class(packages):
    assert load_plugin("method", "a-b", packages, "Method").__name__ == "Method"


def test_an_unknown_plugin_is_named_with_the_nearest(packages):
    with pytest.raises(GeoEvsError, match=r"^there is no method called 'a_b'; did you mean 'a-b'"):
        load_plugin("method", "a_b", packages, "Method")


def test_a_plugin_without_its_class_is_named(packages):
    with pytest.raises(GeoEvsError, match=r"classless/adapter\.py has no class Method; name "):
        load_plugin("method", "classless", packages, "Method")


def test_an_error_of_the_plugin_itself_is_not_hidden(packages):
    with pytest.raises(RuntimeError, match="imported"):
        load_plugin("method", "broken", packages, "Method")


def made(height, width, folder, steps=10):
    """Any factory."""


@pytest.mark.parametrize("options", [{"folder": "x"}, {"folder": "x", "steps": 3}])
def test_options_that_fit_pass(options):
    check_options("it", made, options, positional=2)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"folder": "x", "step": 3}, "it has no option 'step'; did you mean 'steps'?"),
        ({"folder": "x", "height": 3}, "it has no option 'height'; "),
        ({"steps": 3}, "it needs the option 'folder'; set it in its options"),
    ],
)
def test_options_that_do_not_fit_are_named(options, sentence):
    with pytest.raises(GeoEvsError) as caught:
        check_options("it", made, options, positional=2)
    assert str(caught.value).startswith(sentence)


def test_a_factory_without_options_says_so():
    with pytest.raises(GeoEvsError, match=r"^it has no option 'steps'; it has none$"):
        check_options("it", lambda: None, {"steps": 3})


def test_words_that_are_like_nothing_get_the_list_alone():
    assert did_you_mean("qqq", ["b", "a"]) == "one of: a, b"
