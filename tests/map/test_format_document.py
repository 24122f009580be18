"""The page of file formats is enough to read what segloc writes, with struct, json and NumPy."""

from __future__ import annotations

import hashlib
import json
import re
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from samples.plaza import Plaza, PlazaSequence
from samples.source import PROJECT, loaded

from segloc import Config, SegmentMap, build_map
from segloc.descriptors.weightfile import shipped_weights
from segloc.map.compact import CompactConfig, compacted
from segloc.map.config import MappingConfig
from segloc.map.file import FORMAT_VERSION

PAGES = loaded(PROJECT / "docs" / "site.py")
DOCUMENT = PAGES.filled((PROJECT / "docs" / "reference" / "formats.md").read_text("utf-8"))
DTYPES = {"F64": "<f8", "F32": "<f4", "I32": "<i4", "I8": "<i1", "U8": "|u1"}


def table(name: str) -> list[list[str]]:
    """The rows of a generated table of the document, without the backquotes of the first cell."""
    text = PAGES.table(name)
    assert text in DOCUMENT, f"docs/reference/formats.md has no table {name!r}"
    rows = [line.strip("|").split("|") for line in text.splitlines()[2:]]
    return [[row[0].strip().strip("`"), *(cell.strip() for cell in row[1:])] for row in rows]


def opened(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray], dict[str, bytes]]:
    """Header, tensors and the tensors' bytes of a file, as the section Container has them."""
    data = path.read_bytes()
    (length,) = struct.unpack("<Q", data[:8])
    assert length % 8 == 0
    header = json.loads(data[8 : 8 + length])
    body, tensors, raw, reached = data[8 + length :], {}, {}, 0
    for name, entry in header.items():
        if name == "__metadata__":
            continue
        begin, end = entry["data_offsets"]
        raw[name] = body[begin:end]
        tensors[name] = np.frombuffer(raw[name], DTYPES[entry["dtype"]]).reshape(entry["shape"])
        reached += end - begin
    assert reached == len(body), "there is a gap"
    return header, tensors, raw


@pytest.fixture(scope="module")
def site(plaza: Plaza) -> SegmentMap:
    mapping = MappingConfig(compact=CompactConfig(enabled=False))
    made = build_map(PlazaSequence(plaza), Config(threads=1, mapping=mapping))
    masks = np.ones(len(made), bool), np.ones(len(made.cloud), bool)
    return made.kept(*masks, missed=np.arange(len(made)) % 2)


@pytest.fixture(scope="module")
def saved(site: SegmentMap, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("map") / "site.segmap"
    site.save(path)
    return path


@pytest.fixture(scope="module")
def packed(site: SegmentMap, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("map") / "packed.segmap"
    compacted(site, CompactConfig()).save(path)
    return path


def unpacked(name: str, data: bytes, how: dict[str, Any], origin: Any, voxel: float) -> Any:
    """A packed tensor, as the section Packed maps has it."""
    if how["kind"] == "octree":
        return cloud_of(zlib.decompress(data), how, origin, voxel)
    if how["kind"] == "palette":
        size = 8 * how["values"]
        rows = whole_numbers(data[size:], how["shape"][0], how["width"])[:, 0]
        return np.frombuffer(data[:size], "<f8")[rows]
    rows = whole_numbers(data, how["shape"][0], how["width"]) + np.array(how["low"])
    return (rows * 2.0 ** np.array(how["exponents"])).reshape(how["shape"])


def whole_numbers(data: bytes, rows: int, width: int) -> np.ndarray:
    planes = np.frombuffer(zlib.decompress(data), np.uint8).reshape(width, rows, -1)
    numbers = sum(plane.astype(object) << 8 * k for k, plane in enumerate(planes))
    steps = np.where(numbers % 2 == 0, numbers // 2, -(numbers + 1) // 2)
    return (np.cumsum(steps, axis=0) % (1 << 8 * width)).astype(np.int64)


def cloud_of(data: bytes, how: dict[str, Any], origin: Any, voxel: float) -> np.ndarray:
    nodes, at = [(0, 0, 0)], 0
    for _ in range(how["levels"]):
        codes = data[at : at + len(nodes)]
        nodes.sort()
        at += len(nodes)
        nodes = [
            (2 * x + (k >> 2), 2 * y + (k >> 1 & 1), 2 * z + (k & 1))
            for (x, y, z), code in zip(nodes, codes, strict=True)
            for k in range(8)
            if code >> k & 1
        ]
    assert at == how["nodes"] and len(nodes) == how["shape"][0]
    bits = np.unpackbits(np.frombuffer(data[at:], np.uint8), bitorder="little")
    each = bits[: 3 * len(nodes) * how["bits"]].reshape(len(nodes), 3, how["bits"])
    parts = (each << np.arange(how["bits"])).sum(axis=2)
    place = np.array(sorted(nodes)) + how["low"] + (parts + 0.5) / 2 ** how["bits"]
    return (place * voxel - origin).astype(np.float32)


def test_a_packed_map_is_read_as_the_document_says(packed: Path) -> None:
    header, tensors, raw = opened(packed)
    texts, held = header["__metadata__"], SegmentMap.load(packed)
    assert list(tensors) == [row[0] for row in table("map tensors")]
    coding, voxel = json.loads(texts["coding"]), float(texts["cloud_voxel"])
    assert coding.keys() == tensors.keys() - {"origin"}
    for name, how in coding.items():
        assert header[name]["dtype"] == "U8"
        found = unpacked(name, raw[name], how, tensors["origin"], voxel)
        np.testing.assert_array_equal(found, getattr(held, name), name)


def test_a_map_has_the_tensors_of_the_document(site: SegmentMap, saved: Path) -> None:
    header, tensors, _ = opened(saved)
    rows = table("map tensors")
    assert list(tensors) == [row[0] for row in rows], "names, in the order of the document"
    lengths: dict[str, int] = {}
    for name, dtype, shape, *_ in rows:
        assert header[name]["dtype"] == dtype, name
        wanted = [part.strip() for part in shape.strip("()").split(",") if part.strip()]
        assert len(wanted) == tensors[name].ndim, name
        for letter, length in zip(wanted, tensors[name].shape, strict=True):
            expected = int(letter) if letter.isdecimal() else lengths.setdefault(letter, length)
            assert length == expected, (name, letter)
        held = getattr(site, name)
        np.testing.assert_array_equal(tensors[name], held)
    assert set(lengths) == set("PDNV")


@pytest.mark.parametrize("version", [1, FORMAT_VERSION])
def test_a_map_has_the_text_fields_and_checksums_of_the_document(
    saved: Path, packed: Path, version: int
) -> None:
    header, tensors, raw = opened(saved if version == 1 else packed)
    texts = header["__metadata__"]
    named = {row[0] for row in table("map fields")} - {"checksum.NAME"}
    named -= {"coding"} if version == 1 else set()
    assert set(texts) == named | {f"checksum.{name}" for name in tensors}
    assert texts["segmap_version"] == str(version)
    assert f"Format version {FORMAT_VERSION}." in DOCUMENT
    assert {"config", "sequence"} <= json.loads(texts["metadata"]).keys()
    for name, data in raw.items():
        assert texts[f"checksum.{name}"] == hashlib.blake2b(data, digest_size=16).hexdigest()
    shapes = {name: [header[name]["dtype"], header[name]["shape"]] for name in tensors}
    covered = {key: text for key, text in texts.items() if key != "checksum"}
    text = json.dumps([covered, shapes], sort_keys=True).encode()
    assert texts["checksum"] == hashlib.blake2b(text, digest_size=16).hexdigest()


@pytest.mark.parametrize("file", ["profile", "segmap", "segmatch-eigen-forest"])
def test_weights_have_the_fields_and_the_hash_of_the_document(file: str) -> None:
    header, tensors, raw = opened(shipped_weights(f"{file}.safetensors"))
    texts = header["__metadata__"]
    assert set(texts) == {row[0] for row in table("weights fields")}
    kind = texts["format"].removeprefix("segloc ")
    row = re.search(rf"^\| `{kind}` \|.*$", DOCUMENT, re.MULTILINE)
    assert row, f"no kind {kind!r} in the document"
    settings = json.loads(texts["settings"])
    assert all(f"`{key}`" in row[0] for key in settings)
    assert isinstance(json.loads(texts["card"]), dict)
    digest = hashlib.sha256(json.dumps(settings, sort_keys=True).encode())
    for name in sorted(tensors):
        digest.update(f"{name} {tensors[name].shape} ".encode() + raw[name])
    assert texts["sha256"] == digest.hexdigest()
