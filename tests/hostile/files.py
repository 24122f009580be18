"""What is made to break the readers. Nothing large is kept: files are written when needed."""

from __future__ import annotations

import hashlib
import json
import os
import struct
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from samples import datasets as recordings
from samples import io as scans
from samples.datasets import Drive

MAX_POINTS = 1_000_000
"""The limit that they are read under: what exceeds it is smaller and faster to make."""
LIMIT = "SEGLOC_MAX_POINTS"
HUGE = 2**62
START = 1_600_000_000.0


@dataclass(frozen=True)
class Hostile:
    """A file or folder."""

    name: str
    how: str  # it is opened as; see ``hostile.opened``
    make: Callable[[Path], object]  # writes it at a path; may return another path to open
    expected: str  # pattern of the error
    may_be_read: bool  # whether it may turn out to be a scan after all

    def write(self, folder: Path) -> Path:
        path = folder / self.name
        path.parent.mkdir(parents=True, exist_ok=True)
        made = self.make(path)
        return made if isinstance(made, Path) else path


HOSTILE: list[Hostile] = []


def add(how: str, name: str, make: Callable[[Path], object] | bytes, expected: str = "",
        may_be_read: bool = False) -> None:  # fmt: skip
    write = (lambda path: path.write_bytes(make)) if isinstance(make, bytes) else make
    HOSTILE.append(Hostile(name, how, write, expected, may_be_read))


def sparse(size: int) -> Callable[[Path], None]:
    """A file of that size that takes no room on the disk."""

    def make(path: Path) -> None:
        with path.open("wb") as file:
            file.truncate(size)

    return make


# --- scans ----------------------------------------------------------------------------------------


def npy(shape: str, descr: str = "<f4", body: bytes = b"") -> bytes:
    header = f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}".encode()
    header += b" " * (-(len(header) + 11) % 64) + b"\n"
    return b"\x93NUMPY\1\0" + struct.pack("<H", len(header)) + header + body


def bomb(size: int) -> bytes:
    """Zeros, deflated without a zlib header; quick, since blocks repeat."""
    block = 1 << 20
    packer = zlib.compressobj(9, wbits=-15)
    first = packer.compress(bytes(block)) + packer.flush(zlib.Z_FULL_FLUSH)
    again = packer.compress(bytes(block)) + packer.flush(zlib.Z_FULL_FLUSH)
    return first + again * (size // block - 1) + packer.flush()


def archive(name: str, packed: bytes, claimed: int) -> bytes:
    """A ZIP file of one deflated member that claims a size."""
    crc, label = 0, name.encode()
    sizes = struct.pack("<III", crc, len(packed), claimed)
    local = b"PK\3\4" + struct.pack("<HHHHH", 20, 0, 8, 0, 0) + sizes
    local += struct.pack("<HH", len(label), 0) + label + packed
    central = b"PK\1\2" + struct.pack("<HHHHHH", 20, 20, 0, 8, 0, 0) + sizes
    central += struct.pack("<HHHHHII", len(label), 0, 0, 0, 0, 0, 0) + label
    end = b"PK\5\6" + struct.pack("<HHHHIIH", 0, 0, 1, 1, len(central), len(local), 0)
    return local + central + end


def real_bomb(path: Path) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file, file.open("a.npy", "w") as out:
        count = 2 * MAX_POINTS
        out.write(npy(f"({count}, 3)"))
        out.write(bytes(12 * count))


def laz(count: int) -> bytes:
    """Few points that claim to be many; they are all the same, so many would not be larger."""
    data = bytearray(scans.las(np.ones((1000, 3)), point_format=0, times=False, compressed=True))
    struct.pack_into("<I", data, 107, count)
    return bytes(data)


def pcd(*lines: str, body: bytes = b"", encoding: str = "binary") -> bytes:
    header = {
        "FIELDS": "x y z", "SIZE": "4 4 4", "TYPE": "F F F", "COUNT": "1 1 1", "WIDTH": "1",
        "HEIGHT": "1", "POINTS": "1",
    }  # fmt: skip
    header |= dict(line.split(" ", 1) for line in lines)
    text = "".join(f"{key} {value}\n" for key, value in header.items() if value != "-")
    return f"VERSION 0.7\n{text}DATA {encoding}\n".encode() + body


def ply(*lines: str, encoding: str = "binary_little_endian", body: bytes = b"") -> bytes:
    return "\n".join(["ply", f"format {encoding} 1.0", *lines, "end_header", ""]).encode() + body


XYZ = ("property float x", "property float y", "property float z")
ONE = ("element vertex 1", *XYZ)

add("scan", "wide.npy", npy(f"(0, {HUGE})"), "impossible shape")
add("scan", "long.npy", npy(f"({HUGE}, 0)"), "impossible shape")
add("scan", "lie.npy", npy(f"({HUGE}, 3)"), "need")
add("scan", "negative.npy", npy("(-1, 3)"), "not an array")
add("scan", "words.npy", npy("(1 1, 3)"), "bad header")
add("scan", "objects.npy", npy("(1, 3)", "|O"), "not an array")
add("scan", "many.npy", npy(f"({2 * MAX_POINTS}, 3)", "|i1", bytes(6 * MAX_POINTS)), LIMIT)
add("scan", "float16.npy", npy("(9, 3)", "<f2", bytes(54)), may_be_read=True)
add("scan", "bomb.npz", archive("points.npy", bomb(200 << 20), 200 << 20), LIMIT)
add("scan", "real_bomb.npz", real_bomb, LIMIT)
add("scan", "lie.npz", archive("points.npy", b"\3\0", 1 << 31), "cannot hold")
add("scan", "short_lie.npz", archive("points.npy", bomb(20 << 20), 100), "NPZ|NPY|header")
add("scan", "noise.npz", b"PK\3\4" + bytes(range(256)) * 9, "NPZ")
add("scan", "many.laz", laz(50_000_000), LIMIT)
add("scan", "lie.laz", laz(900_000), "promises 900000")
add("scan", "noise.las", b"LASF" + b"\xff" * 4000, "LAS")
add("scan", "many.pcd", pcd("WIDTH 999999999999", "POINTS 999999999999"), LIMIT)
add("scan", "product.pcd", pcd(f"WIDTH {10**17}", f"HEIGHT {10**17}", f"POINTS {10**17}"), "POINTS")
add("scan", "wide.pcd", pcd(f"COUNT 1 1 {10**17}"), "need|no field")
add("scan", "fields.pcd", pcd(f"FIELDS {'a ' * 99_999}", f"SIZE {'4 ' * 99_999}",
    f"TYPE {'F ' * 99_999}", "COUNT -"), "need|no field")  # fmt: skip
add("scan", "packed.pcd", pcd(f"WIDTH {MAX_POINTS}", f"POINTS {MAX_POINTS}",
    encoding="binary_compressed", body=struct.pack("<II", 100, 12 * MAX_POINTS) + bytes(100)),
    "pcd: ")  # fmt: skip
add("scan", "words.pcd", pcd(encoding="ascii", body=b"one two three\n"), "parse")
add("scan", "no_end.pcd", b"FIELDS x\n" * 200_000, "no DATA")
add("scan", "untyped.ply", ply("element face 1", "property list", *ONE), "unknown property")
add("scan", "half.ply", ply("element face 1", "property list uchar", *ONE), "unknown property")
add("scan", "bare.ply", ply("element vertex 1", "property"), "unknown property")
add("scan", "rows.ply", ply(f"element face {10**17}", "property list uchar int i", *ONE), LIMIT)
add("scan", "many.ply", ply(f"element vertex {10**17}", *XYZ), LIMIT)
add("scan", "endless.ply", ply("element face 2", "property list uint int i", *ONE,
    body=b"\xff" * 40), "cut off|need")  # fmt: skip
add("scan", "lists.ply", ply("element face 900000", "property list uchar uchar i", *ONE,
    body=b"\0\1\0" * 450_000 + bytes(12)), "1 points", may_be_read=True)  # fmt: skip
add("scan", "ascii.ply", ply("element vertex 900000", *XYZ, encoding="ascii", body=b"1 2 3\n"),
    "promises 900000")  # fmt: skip
add("scan", "many.vtk", b"# vtk DataFile\n\nASCII\nPOINTS 99999999999999999 float\n1 2 3\n", LIMIT)
add("scan", "words.vtk", b"# vtk DataFile\n\nASCII\nPOINTS 1 float\n1 2 x 4 5 6\n", "vtk")
add("scan", "lie.vtk", b"# vtk DataFile\n\nBINARY\nPOINTS 900000 double\n" + bytes(99), "need")
add("scan", "line.csv", b"1," * 3_000_000, "characters|line of")
add("scan", "columns.csv", b"x,y,z," + b"a," * 20_000 + b"\n1,2,3\n", "columns")
add("scan", "digits.xyz", b"1 2 " + b"9" * 50_000 + b"\n", may_be_read=True)
add("scan", "long_digits.xyz", b"1 2 " + b"9" * 500_000 + b"\n", "characters")
add("scan", "zeros.xyz", bytes(5_000_000), "xyz")
add("scan", "huge.xyz", b"1e999 1e-999 nan\n" * 9, may_be_read=True)
add("scan", "rows.txt", b"1 2 3\n" * (MAX_POINTS + 9), LIMIT)
add("scan", "blank.txt", b"\n" * 9_000_000, may_be_read=True)
add("scan", "comments.txt", b"#\n" * 1_000_000, may_be_read=True)
add("scan", "nan.bin", b"\xff" * 16_000, may_be_read=True)
add("scan", "far.bin", np.full((400, 4), 3e38, "<f4").tobytes(), "not a KITTI scan")
add("scan", "many.bin", np.tile(np.float32([1, 50, 9, 0.1]), MAX_POINTS + 1).tobytes(), LIMIT)
for suffix in ("bin", "pcd.bin", "pcd", "ply", "csv", "vtk", "las", "laz", "npy", "npz", "xyz"):
    add("scan", f"sparse.{suffix}", sparse(1 << 40), LIMIT)
add("scan", "pipe.pcd", os.mkfifo, "not a regular file")
add("scan", "zero.bin", lambda path: path.symlink_to("/dev/zero"), "not a regular file")
add("scan", "lost.ply", lambda path: path.symlink_to("nowhere"), "no such file")
add("scan", "loop.ply", lambda path: path.symlink_to(path), "no such file|cannot read")
add("scan", "folder.las", Path.mkdir, "not a regular file")
add("scan", "line\nbreak.pcd", b"FIELDS x\n", "no DATA")


# --- trajectories ---------------------------------------------------------------------------------


def tum(*xs: float, count: int = 0) -> bytes:
    rows = [f"{k} {x} 0 0 0 0 0 1" for k, x in enumerate([*xs, *range(count)])]
    return "\n".join(rows).encode()


add("trajectory", "huge.g2o", b"VERTEX_SE3:QUAT 0 1e300 0 0 0 0 0 1\n", "beyond")
add("trajectory", "lie.pcd", pcd(f"POINTS {HUGE}", f"WIDTH {HUGE}"), "WIDTH|POINTS|SEGLOC")
add("trajectory", "lie.npy", npy(f"({HUGE}, 4, 4)"), "need")
add("trajectory", "far.tum", tum(0, 1, 1e12), "line 3: a position beyond 1e.08 m")
add("trajectory", "infinite.tum", tum(0, float("inf")), "line 2")
add("trajectory", "jump.tum", tum(0, 1, 450_000.0, 450_001.0), "line 3: a position more than")
add("trajectory", "zero.tum", b"0 0 0 0 0 0 0 0", "length 0")
add("trajectory", "sparse.tum", sparse(1 << 40), LIMIT)
add("trajectory", "many.tum", b"0 0 0 0 0 0 0 1\n" * (MAX_POINTS + 9), LIMIT)
add("trajectory", "line.tum", b"1 " * 3_000_000, "columns")
add("trajectory", "digits.tum", b"0 " * 7 + b"1" * 400_000, "line 1", may_be_read=True)
add("trajectory", "kitti.txt", b"1 0 0 1e300 0 1 0 0 0 0 1 0\n", "beyond")
add("trajectory", "scale.txt", b"1e200 0 0 0 0 1 0 0 0 0 1 0\n", "rigid")
add("trajectory", "noise.tum", bytes(range(256)) * 100, "tum")
add("trajectory", "utm.tum", b"0 450000 5400000 100 0 0 0 1\n1 450001 5400001 100 0 0 0 1\n",
    may_be_read=True)  # fmt: skip
add("trajectory", "pipe.tum", os.mkfifo, "not a regular file")


# --- configurations -------------------------------------------------------------------------------

LAUGHS = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{chr(98 + k)}: &{chr(98 + k)} [{', '.join(['*' + chr(97 + k)] * 9)}]\n" for k in range(12)
)
add("config", "laughs.yaml", LAUGHS.encode(), "references")
add("config", "merge.yaml", b"a: &a {b: 1}\nc:\n  <<: *a\n", "references")
add("config", "deep.yaml", b"[" * 50_000, "nested|not YAML")
add("config", "deeper.yaml", b"a: " + b"[" * 5000 + b"]" * 5000, "nested")
add("config", "block.yaml", b"".join(b" " * k + b"a:\n" for k in range(400)), "nested")
add("config", "sparse.yaml", sparse(1 << 40), "longer than")
add("config", "date.yaml", b"seed: 2001-99-99\n", "not YAML")
add("config", "digits.yaml", b"seed: " + b"9" * 9000, "yaml")
add("config", "number.yaml", b"seed: 0x\nthreads: 1:99:99:99\n", "yaml")
add("config", "python.yaml", b"method: !!python/object/apply:os.abort []\n", "not YAML")
add("config", "keys.yaml", b"1: 2\n? [a, b]\n: c\n", "yaml")
add("config", "key.yaml", b"1: 2\n", "yaml")
add("config", "rows.yaml", b"- 1\n", "mapping")
add("config", "list.yaml", b"method: [1, 2]\npose: 3\n", "method|descriptor")
add("config", "bytes.yaml", b"\xff\xfe\0\0", "cannot be read")
add("config", "control.yaml", b"a: \x01\n", "not YAML")
add("config", "pipe.yaml", os.mkfifo, "not a regular file")


# --- weights --------------------------------------------------------------------------------------


def weights(header: bytes | dict[str, Any], body: bytes = b"", size: int | None = None) -> bytes:
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    return struct.pack("<Q", len(text) if size is None else size) + text + body


def network(kind: str, settings: Any, card: Any = None, **shapes: tuple[int, ...]) -> bytes:
    """A weights file whose hash is right."""
    text = json.dumps(settings, sort_keys=True)
    digest = hashlib.sha256(text.encode())
    body, tensors = b"", {}
    for name in sorted(shapes):
        data = np.zeros(shapes[name], "<f4").tobytes()
        span = [len(body), len(body) + len(data)]
        tensors[name] = {"dtype": "F32", "shape": list(shapes[name]), "data_offsets": span}
        digest.update(f"{name} {shapes[name]} ".encode() + data)
        body += data
    metadata = {"format": f"segloc {kind}", "version": "2", "settings": text,
                "card": json.dumps(card or {}), "sha256": digest.hexdigest()}  # fmt: skip
    return weights({"__metadata__": metadata, **tensors}, body)


def layers(**values: Any) -> dict[str, str]:
    row = {"points": 160, "neighbors": 8, "dilation": 1, "channels": 16} | values
    return {"points": "256", "alignment": "pca2d", "layers": json.dumps([row])}


add("weights", "long.safetensors", weights(b"{}", size=2**63), "safetensors")
add("weights", "deep.safetensors", weights(b'{"a":' + b"[" * 90_000), "safetensors")
add("weights", "empty.safetensors", b"", "safetensors")
add("weights", "sparse.safetensors", sparse(1 << 40), LIMIT)
add("weights", "lie.safetensors", weights({"a": {"dtype": "F32", "shape": [2**40],
    "data_offsets": [0, 2**42]}}), "safetensors")  # fmt: skip
add("weights", "overflow.safetensors", weights({"a": {"dtype": "F32", "shape": [2**33, 2**33],
    "data_offsets": [0, 0]}}), "safetensors")  # fmt: skip
for dtype in ("BF16", "F8_E4M3", "BOOL", "U64", "F4", "X"):
    add("weights", f"{dtype}.safetensors", weights({"a": {"dtype": dtype, "shape": [8],
        "data_offsets": [0, 16]}}, bytes(16)), "safetensors")  # fmt: skip
add("weights", "settings.safetensors", weights({"__metadata__": {"format": "segloc profile network",
    "version": "2", "settings": "[" * 90_000, "card": "{}"}}), "metadata")  # fmt: skip
for name, values in {
    "none": layers(neighbors=0), "minus": layers(points=-1), "huge": layers(channels=2**31),
    "beyond": layers(points=2**70), "text": layers(points="a"), "real": layers(dilation=0.5),
    "points": {**layers(), "points": "9" * 99}, "empty": {**layers(), "layers": "[]"},
    "deep": {**layers(), "layers": "[" * 90_000}, "null": {**layers(), "layers": "null"},
    "other": {**layers(), "layers": '[{"a": 1}]'}, "number": {"layers": 5},
}.items():  # fmt: skip
    add("weights", f"layers-{name}.safetensors", network("network", values, a=(1,)),
        "safetensors")  # fmt: skip
add(
    "weights",
    "profile.safetensors",
    network("profile network", {"profile": "1"}, a=(3,)),
    "profile",
)
add("weights", "forest.safetensors", network("forest", {"descriptor": "x"}), "forest")
add("weights", "pipe.safetensors", os.mkfifo, "not a regular file")


# --- recordings -----------------------------------------------------------------------------------


def drive() -> Drive:
    return Drive.make(3, 40)


def bag(kind: str, packing: str, size: int, *, count: int = 1) -> Callable[[Path], object]:
    """Clouds of zeros in a bag that packs them well."""

    def make(path: Path) -> None:
        from samples.bags import BagWriter

        samples = BagWriter(kind)
        for k in range(count):
            points = np.full((size // 16, 3), float(count > 1))
            samples.cloud("/points", START + k, points)
        samples.write(path, packing)

    return make


def cut(make: Callable[[Path], object], share: float) -> Callable[[Path], object]:
    """The same, cut off in the middle; of a folder its largest file."""

    def cut_off(path: Path) -> None:
        make(path)
        places = [path] if path.is_file() else list(path.iterdir())
        file = max(places, key=lambda each: each.stat().st_size)
        data = file.read_bytes()
        file.write_bytes(data[: int(share * len(data))])

    return cut_off


def imu(first: bytes) -> Callable[[Path], object]:
    """A bag with a cloud, and messages of an IMU that begin like this."""

    def make(path: Path) -> None:
        from samples.bags import IMU, BagWriter

        samples = BagWriter("sqlite3")
        samples.cloud("/points", START, np.ones((9, 3)))
        time = samples.messages[0][0]
        samples.messages += [(time + k, "/imu", IMU, first) for k in range(9)]
        samples.write(path)

    return make


HEAD = b"\0\1\0\0" + struct.pack("<iII", int(START), 0, 4) + b"imu\0"
add("sequence", "imu-cut.d", imu(HEAD), "not used", may_be_read=True)
noise = imu(b"\0\1\0\0" + b"\xff" * 400)
add("sequence", "imu-noise.d", noise, "not used", may_be_read=True)
add(
    "sequence", "imu-nan.d", imu(HEAD + struct.pack("<37d", *[float("nan")] * 37)), may_be_read=True
)
add("sequence", "imu-huge.d", imu(HEAD + struct.pack("<37d", *[1e308] * 37)), may_be_read=True)

LARGE = 30_000_000  # more than a message may have
for packing in ("BZ2", "LZ4"):
    add("sequence", f"{packing.lower()}.bag", bag("ros1", packing, LARGE), LIMIT)
add("sequence", "message.sqlite3", bag("sqlite3", "MESSAGE", LARGE), LIMIT)
add("sequence", "message.mcap.d", bag("mcap", "MESSAGE", LARGE), LIMIT)
add("sequence", "storage.mcap.d", bag("mcap", "STORAGE", LARGE), LIMIT)
# Every message is within the limit, the file is not.
for kind in ("sqlite3", "mcap"):
    add("sequence", f"file.{kind}.d", bag(kind, "FILE", 3_000_000, count=18),
        f"compressed file.*{LIMIT}")  # fmt: skip
SIZES = (160_000, 12)
for kind, packing in (("ros1", ""), ("ros1", "LZ4"), ("sqlite3", ""), ("mcap", ""),
                      ("mcap", "STORAGE")):  # fmt: skip
    for share in (0.3, 0.6, 0.9, 0.99):
        suffix = ".bag" if kind == "ros1" else ".d"
        add("sequence", f"cut-{kind}{packing.lower()}-{share}{suffix}",
            cut(bag(kind, packing, SIZES[0], count=SIZES[1]), share), "cut|bag|read")  # fmt: skip


def ros1_index(connections: int, chunks: int) -> Callable[[Path], object]:
    """A ROS 1 bag whose index names its one connection and its one chunk several times."""

    def make(path: Path) -> None:
        bag("ros1", "", 16, count=2000)(path)
        data = bytearray(path.read_bytes())
        (index,) = struct.unpack_from("<Q", data, data.index(b"index_pos=") + 10)
        chunk = data.index(b"op=\x06", index) - 8
        struct.pack_into("<I", data, data.index(b"conn_count=") + 11, connections)
        struct.pack_into("<I", data, data.index(b"chunk_count=") + 12, chunks)
        path.write_bytes(data[:index] + data[index:chunk] * connections + data[chunk:] * chunks)

    return make


add("sequence", "chunks.bag", ros1_index(1, 20_000), "the index is longer")
add("sequence", "connections.bag", ros1_index(3, 1), "share an id")


def lying_mcap(path: Path) -> None:
    """A chunk of zstd that holds more than its record declares, in a file without an index."""
    bag("mcap", "STORAGE", LARGE)(path)
    file = next(path.glob("*.mcap"))
    data = bytearray(file.read_bytes())
    place = data.index(b"\x06", 8)
    while data[place + 9 + 28 : place + 9 + 36] != b"\4\0\0\0zstd":
        place = data.index(b"\x06", place + 1)
    struct.pack_into("<QI", data, place + 9 + 16, 5000, 0)  # its size and checksum
    data[-28:-12] = bytes(16)  # no summary: it is read through
    file.write_bytes(data)


add("sequence", "lying.mcap.d", lying_mcap, "holds more|cannot be read")


def other_mcap(schema: bytes, encoding: str, size: int | None = None) -> Callable[[Path], object]:
    """Clouds of no bytes in a chunk without an index, which may lie about its size."""

    def make(path: Path) -> None:
        from samples.mcap import write_mcap

        channel = ("/points", encoding, "sensor_msgs/msg/PointCloud2", schema, "ros2msg")
        write_mcap(path, [channel], [(0, 1, b"\0\1\0\0")], profile="x" * 999, chunked=True)
        data = bytearray(path.read_bytes())
        place = data.rindex(b"\x08" + struct.pack("<Q", 64))
        if size is not None:
            struct.pack_into("<QQ", data, place + 9 + 48, size, size)
        path.write_bytes(data)

    return make


ITSELF = b"sensor_msgs/PointCloud2 next\n"
add("sequence", "itself.mcap", other_mcap(ITSELF, "cdr"), "no header|cut off|bag")
add("sequence", "schema.mcap", other_mcap(b"\xff" * 9999, "cdr"), "no header|cut off|bag")
add("sequence", "protobuf.mcap", other_mcap(b"\xff\xfe", "protobuf"), "is not read")
add("sequence", "chunk.mcap", other_mcap(b"", "cdr", HUGE), "memory")


def log_beside(data: bytes) -> Callable[[Path], object]:
    """A log that a recorder left beside its database."""

    def make(path: Path) -> Path:
        bag("sqlite3", "", 1600)(path)
        file = next(path.glob("*.db3"))
        file.with_name(f"{file.name}-wal").write_bytes(data)
        return file

    return make


LOG = struct.pack(">IIIIIIII", 0x377F0682, 3007000, 4096, 0, 1, 2, 3, 4)  # its head, without sums
add("sequence", "log.d", log_beside(b"\xff" * 70_000), may_be_read=True)
add("sequence", "log_head.d", log_beside(LOG + b"\xff" * 70_000), may_be_read=True)


def metadata(text: bytes) -> Callable[[Path], object]:
    def make(path: Path) -> None:
        bag("mcap", "", 1600)(path)
        (path / "metadata.yaml").write_bytes(text)

    return make


add("sequence", "laughs.d", metadata(LAUGHS.encode()), "metadata")
add("sequence", "block.d", metadata(b"".join(b" " * k + b"a:\n" for k in range(400))), "nested")


def deep_qos(path: Path) -> None:
    """A topic in SQLite whose quality of service is nested."""
    import sqlite3

    bag("sqlite3", "", 1600)(path)
    with sqlite3.connect(next(path.glob("*.db3"))) as database:
        database.execute("UPDATE topics SET offered_qos_profiles = ?", ["[" * 20_000])


add("sequence", "qos.d", deep_qos, "nested")
add("sequence", "deep.d", metadata(b"[" * 20_000), "nested")
add("sequence", "long.d", metadata(b"a: [b, c]\n" * 200_000), "metadata.yaml of")
add("sequence", "list.d", metadata(b"rosbag2_bagfile_information: [1]"), "bag")


def tables(**changes: Any) -> Callable[[Path], object]:
    """nuScenes with other tables."""

    def make(path: Path) -> None:
        root = recordings.nuscenes(path, drive())
        for name, rows in changes.items():
            text = rows if isinstance(rows, bytes) else json.dumps(rows).encode()
            (root / "v1.0-mini" / f"{name}.json").write_bytes(text)

    return make


def mended(**values: Any) -> list[dict[str, Any]]:
    return [{"token": f"e{i}", "translation": [0, 0, 0], "rotation": [1, 0, 0, 0], **values}
            for i in range(3)]  # fmt: skip


for name, change in {
    "numbers": {"scene": [1, 2]}, "map": {"scene": {"a": 1}}, "deep": {"scene": b"[" * 90_000},
    "nothing": {"scene": []},
    "lists": {"scene": [{"token": ["s"], "name": ["a"]}]}, "strings": {"sample_data": ["a"]},
    "time": {"sample_data": [{"timestamp": "now"}]}, "tokens": {"sensor": [{"token": []}]},
    "short": {"ego_pose": mended(translation=[1])}, "text": {"ego_pose": mended(rotation="a")},
    "zero": {"ego_pose": mended(rotation=[0, 0, 0, 0])},
    "nan": {"ego_pose": mended(translation=[float("nan")] * 3)},
    "ragged": {"ego_pose": mended(translation=[[1], [2, 3], 4])},
    "far": {"ego_pose": mended(translation=[1e12, 0, 0])}, "null": {"sample_data": b"null"},
    "infinite": {"sample_data": b'[{"timestamp": 1e999}]'}, "noise": {"scene": b"\xff\xfe"},
}.items():  # fmt: skip
    posed = "ego_pose" in change  # the scans are read, with a note that poses are not used
    expected = "not used" if posed else f"nuscenes-{name}"
    add("sequence", f"nuscenes-{name}", tables(**change), expected, posed)


def changed(
    make: Callable[[Path, Drive], Path], file: str, data: bytes
) -> Callable[[Path], object]:
    """A recording with another file in it."""

    def write(path: Path) -> Path:
        root = make(path, drive())
        assert (root / file).is_file(), sorted(root.rglob("*"))
        (root / file).write_bytes(data)
        return root

    return write


def altered(name: str, make: Callable[[Path, Drive], Path], file: str, **contents: bytes) -> None:
    for what, data in contents.items():
        add("sequence", f"{name}-{what}", changed(make, file, data), may_be_read=True)


ROW = b"1 0 0 0 0 1 0 0 0 0 1 0\n"
NOISE = bytes(range(256)) * 20
altered("kitti", recordings.kitti, "calib.txt", nan=b"Tr: " + b"nan " * 12, noise=NOISE,
        zero=b"Tr: " + b"0 " * 12, mirror=b"Tr: -" + ROW, short=b"Tr: 1 2\n")  # fmt: skip
altered("kitti_times", recordings.kitti, "times.txt", nan=b"nan\n" * 3, words=b"now\n" * 3,
        long=b"1 " * 900_000, bytes=b"\xff" * 999, infinite=b"1e999\n" * 3)  # fmt: skip
altered("kitti_raw", recordings.kitti_raw, "velodyne_points/timestamps.txt", nat=b"NaT\n" * 3,
        zones=b"2011-01-01T00:00:00Z\n" * 3, noise=NOISE)  # fmt: skip
altered("mulran", recordings.mulran, "global_pose.csv", nan=b"nan," * 12 + b"1\n", noise=NOISE,
        zero=b"0," * 12 + b"0\n", words=b"a," * 13, short=b"1,2\n", blank=b"\n" * 9,
        far=b"1,1,0,0,1e12,0,1,0,0,0,0,1,0\n", comments=b"#\n" * 9)  # fmt: skip


def ouster(text: bytes | dict[str, Any]) -> Callable[[Path], object]:
    """A capture with metadata of its own."""

    def make(path: Path) -> None:
        from samples.ouster import Ouster, recorded

        sensor = Ouster()
        recorded(path, sensor, 1)
        known = sensor.metadata("new")
        data = text if isinstance(text, bytes) else json.dumps(_altered(known, text)).encode()
        path.with_suffix(".json").write_bytes(data)

    return make


def _altered(document: Any, changes: dict[str, Any]) -> Any:
    """The metadata with some entries changed wherever they are."""
    if not isinstance(document, dict):
        return document
    return {k: changes[k] if k in changes else _altered(v, changes) for k, v in document.items()}


NAME = b'"beam_altitude_angles"'
for name, text in {
    "deep": b"{" + NAME + b":" + b"[" * 90_000, "list": b"[" + NAME + b"]",
    "beams": b"{" + NAME + b":[" + b"0," * 99_999 + b'0],"beam_azimuth_angles":['
    + b"0," * 99_999 + b'0],"lidar_mode":"1024x10"}',
    "nan": b"{" + NAME + b':[NaN],"beam_azimuth_angles":[0],"lidar_mode":"1024x10"}',
    "mode": {"lidar_mode": "axb", "columns_per_frame": "x"},
    "columns": {"columns_per_frame": 10**30, "columns_per_packet": -1},
    "huge": {"columns_per_packet": 32_000, "pixels_per_column": 32_000},
    "matrix": {"lidar_to_sensor_transform": [1, 2, 3]},
    "far": {"lidar_to_sensor_transform": [1e308] * 16}, "port": {"udp_port_lidar": "a"},
    "imu": {"imu_to_sensor_transform": [1e308] * 16},
    "imu-nan": {"imu_to_sensor_transform": [float("nan")] * 16},
}.items():  # fmt: skip
    add("sequence", f"ouster-{name}.pcap", ouster(text), may_be_read=True)

PCAP = struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1)


def fragments(count: int) -> bytes:
    """First parts of one datagram, whose last never comes."""
    rows = []
    for k in range(count):
        head = struct.pack(">BBHHHBBH", 0x45, 0, 28, 7, 0x2000 | k % 8192, 64, 17, 0) + bytes(8)
        frame = bytes(12) + b"\x08\x00" + head + bytes(8)
        rows.append(struct.pack("<IIII", 0, 0, len(frame), len(frame)) + frame)
    return b"".join(rows)


add("sequence", "fragments.pcap", PCAP + fragments(60_000), "no Velodyne turn")
add("sequence", "nothing.pcap", PCAP + bytes(16) * 200_000, "no Velodyne turn")
add("sequence", "vlan.pcap", PCAP + struct.pack("<IIII", 0, 0, 4_000_000, 0)
    + b"\x81\x00" * 2_000_000, "no Velodyne turn")  # fmt: skip
add("sequence", "short.pcap", PCAP[:20], "cut off")
add(
    "sequence",
    "sparse.pcap",
    lambda path: path.write_bytes(PCAP + b"\xff" * 9000),
    "no Velodyne turn",
)
