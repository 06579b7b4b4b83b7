"""A storage that is a folder, for tests: Snakemake copies from it and to it, as with a bucket."""

import shutil
from pathlib import Path

from snakemake_interface_storage_plugins.io import Mtime
from snakemake_interface_storage_plugins.storage_object import (
    StorageObjectRead,
    StorageObjectWrite,
)
from snakemake_interface_storage_plugins.storage_provider import (
    StorageProviderBase,
    StorageQueryValidationResult,
)


class StorageProvider(StorageProviderBase):
    """Paths of the folder are what is asked for."""

    def use_rate_limiter(self):
        return False

    def rate_limiter_key(self, query, operation):
        return None

    def default_max_requests_per_second(self):
        return 1.0

    def list_objects(self, query):
        return map(str, Path(query).rglob("*"))

    @classmethod
    def example_queries(cls):
        return []

    @classmethod
    def is_valid_query(cls, query):
        return StorageQueryValidationResult(query=query, valid=True)


class StorageObject(StorageObjectRead, StorageObjectWrite):
    """A file or folder in it."""

    def __post_init__(self):
        self.stored = Path(self.query)

    async def inventory(self, cache):
        key = self.cache_key()
        cache.exists_in_storage[key] = self.exists()
        if self.exists():
            cache.mtime[key] = Mtime(storage=self.mtime())
            cache.size[key] = self.size()

    def get_inventory_parent(self):
        return None

    def local_suffix(self):
        return self.query

    def cleanup(self):
        pass

    def exists(self):
        return self.stored.exists()

    def mtime(self):
        return self.stored.stat().st_mtime

    def size(self):
        return self.stored.stat().st_size

    def retrieve_object(self):
        _copy(self.stored, self.local_path())

    def store_object(self):
        self.stored.parent.mkdir(parents=True, exist_ok=True)
        _copy(self.local_path(), self.stored)

    def remove(self):
        _remove(self.stored)


def _copy(source, place):
    _remove(place)
    (shutil.copytree if source.is_dir() else shutil.copy2)(source, place)


def _remove(path):
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
