import sys

import pytest

from geoevs.core.errors import GeoEvsError, did_you_mean
from geoevs.core.plugins import find_plugins, load_plugin
from geoevs.core.settings import check_options


@pytest.fixture
def packages(tmp_path, monkeypatch):
    """Two packages of plugins: `one` has a-b and shared, `two` has shared and classless."""
    for package, folder, text in [
        ("one", "a_b", "class Method:\n    pass\n"),
        ("one", "shared", "raise RuntimeError('imported')\n"),
        ("two", "shared", ""),
        ("two", "classless", ""),
    ]:
        (tmp_path / package / folder).mkdir(parents=True)
        (tmp_path / package / folder / "adapter.py").write_text(text)
    (tmp_path / "one" / "no_plugin").mkdir()
    (tmp_path / "one" / "adapter.py").write_text("")
    monkeypatch.syspath_prepend(tmp_path)
    yield find_plugins("adapter", "one", "two")
    for name in [name for name in sys.modules if name.split(".")[0] in ("one", "two")]:
        del sys.modules[name]


def test_plugins_are_folders_with_the_file_and_are_not_imported(packages):
    assert packages == {
        "a-b": "one.a_b.adapter",
        "shared": "one.shared.adapter",
        "classless": "two.classless.adapter",
    }


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
        load_plugin("method", "shared", packages, "Method")


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
