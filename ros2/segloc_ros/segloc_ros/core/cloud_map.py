"""A finished cloud as the map: built once, and cached beside it under the cloud's checksum."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterator
from pathlib import Path

from segloc import Config, DatasetError, MapFormatError, SeglocError, SegmentMap
from segloc.robot import Float64, cloud_files, cloud_sources, is_cloud, read_cloud
from segloc.tiles import holds_tiles

Progress = Callable[[str], None]
Note = Callable[[str], None]
_PART_BYTES = 1 << 24


def is_url(path: str) -> bool:
    """Return whether a path is a URL, of tiles."""
    return "://" in path


def holds_cloud(path: str) -> bool:
    """Return whether a path is a cloud file, or a folder of clouds, and no map or tiles."""
    where = Path(path)
    if is_url(path):
        return False
    if not where.is_dir():
        return is_cloud(where)
    try:
        return not holds_tiles(path)
    except MapFormatError:
        pass
    try:
        return bool(cloud_files(path))
    except DatasetError:
        return False


def cloud_signature(path: str) -> tuple[int, int, int]:
    """Return what changes whenever a file of a cloud does: newest time, bytes, number of files."""
    found = [file.stat() for file in cloud_sources(path)]
    return max(f.st_mtime_ns for f in found), sum(f.st_size for f in found), len(found)


def map_of_cloud(path: str, threads: int, progress: Progress, note: Note) -> SegmentMap:
    """Return the map of a cloud: the cached one, or a new one, which is then cached.

    The cache is ``CLOUD.CHECKSUM.segmap`` beside the cloud; in a read-only folder it is in the
    user's cache. A damaged one is replaced. ``progress`` is called often; an exception that it
    raises ends the work. Raise SeglocError if the cloud cannot be read, or is no map.
    """
    name = Path(path).name
    progress(f"reading {name}")
    cached = _caches(Path(path), _checksum(path, lambda: progress(f"reading {name}")))
    for file in cached:
        if file.is_file():
            try:
                return SegmentMap.load(file)
            except SeglocError as error:
                note(f"the cached map is built again: {error}")

    def parts() -> Iterator[Float64]:
        points = 0
        for part in read_cloud(path):
            points += len(part)
            progress(f"reading {name}: {points / 1e6:.0f} million points")
            yield part

    def built(done: int, total: int) -> None:
        progress(f"building the map of {name}: {10 * (10 * done // max(1, total))} %")

    config = Config.load(None).model_copy(update={"threads": threads})
    prior_map = SegmentMap.from_cloud(parts(), config, progress=built, note=note)
    prior_map.metadata["sequence"] = name
    note(_saved(prior_map, cached))
    return prior_map


def _caches(path: Path, checksum: str) -> tuple[Path, Path]:
    """Return where the map of a cloud is cached: beside it, or else for the user."""
    where = path.resolve()
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    file = f"{where.name}.{checksum}.segmap"
    return where.with_name(file), base / "segloc" / "maps" / file


def _checksum(path: str, progress: Callable[[], None]) -> str:
    """Return a checksum of the files of a cloud, and of what places them, as 16 digits."""
    digest = hashlib.blake2b(digest_size=8)
    for file in cloud_sources(path):
        digest.update(f"{file.name} {file.stat().st_size} ".encode())
        with file.open("rb") as stream:
            while part := stream.read(_PART_BYTES):
                digest.update(part)
                progress()
    return digest.hexdigest()


def _saved(prior_map: SegmentMap, files: tuple[Path, ...]) -> str:
    """Save a map to the first file that can be written; return a remark."""
    fault = ""
    for file in files:
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            prior_map.save(file)
            return f"map cached as {file}"
        except (SeglocError, OSError) as error:
            fault = fault or str(error)
    return f"map not cached, so it is built at each start: {fault}"
