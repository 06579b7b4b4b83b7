"""Adapters that tests write into a repository of their own."""

import pytest

import baselines


@pytest.fixture
def repository(tmp_path, monkeypatch):
    """An empty repository whose baselines are found beside the real ones."""
    (tmp_path / "baselines").mkdir()
    paths = [*baselines.__path__, str(tmp_path / "baselines")]
    monkeypatch.setattr(baselines, "__path__", paths)
    return tmp_path


@pytest.fixture
def adapter(repository, request):
    """Writes an adapter under a name of the test's own, and gives the name."""

    def write(text):
        number = sum(1 for _ in (repository / "baselines").iterdir())
        module = f"written_{abs(hash(request.node.nodeid))}_{number}"
        folder = repository / "baselines" / module
        folder.mkdir()
        (folder / "__init__.py").write_text("")
        (folder / "adapter.py").write_text(text)
        return module.replace("_", "-")

    return write
