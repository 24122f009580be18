"""Writers of point cloud files that know nothing of the readers under test."""

from __future__ import annotations

import io
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.floating[Any]]


def lzf_compress(data: bytes) -> bytes:
    """Greedy LZF: a copy wherever the next three bytes were seen within 8 KiB, else literals."""
    out, literals, seen, at = bytearray(), bytearray(), {}, 0

    def flush() -> None:
        for start in range(0, len(literals), 32):
            run = literals[start : start + 32]
            out.append(len(run) - 1)
            out.extend(run)
        literals.clear()

    while at < len(data):
        found = seen.get(data[at : at + 3], -1)
        seen[data[at : at + 3]] = at
        back = at - found - 1
        if found < 0 or back >= 8192 or at + 3 > len(data):
            literals.append(data[at])
            at += 1
            continue
        length = 3
        while (
            length < 264 and at + length < len(data) and data[found + length] == data[at + length]
        ):
            length += 1
        flush()
        if length < 9:
            out += bytes([(length - 2) << 5 | back >> 8, back & 255])
        else:
            out += bytes([7 << 5 | back >> 8, length - 9, back & 255])
        at += length
    flush()
    return bytes(out)


def pcd(rows: NDArray[np.void], encoding: str) -> bytes:
    """A PCD of a structured array; fields called pad... are written with the name _."""
    fields = rows.dtype.fields
    assert fields is not None
    kinds = {"f": "F", "i": "I", "u": "U"}
    base = {name: dtype.base for name, (dtype, *_) in fields.items()}
    sizes = [str(each.itemsize) for each in base.values()]
    counts_ = [str(int(np.prod(dtype.shape, dtype=int))) for dtype, *_ in fields.values()]
    names = ["_" if name.startswith("pad") else name for name in fields]
    header = (
        f"# a comment\nVERSION 0.7\nFIELDS {' '.join(names)}\nSIZE {' '.join(sizes)}\n"
        f"TYPE {' '.join(kinds[each.kind] for each in base.values())}\nCOUNT {' '.join(counts_)}\n"
        f"WIDTH {len(rows)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(rows)}\n"
        f"DATA {encoding}\n"
    ).encode()
    if encoding == "ascii":
        flat = [np.concatenate([np.ravel(row[name]) for name in fields]) for row in rows]
        return header + "".join(" ".join(map(repr_number, row)) + "\n" for row in flat).encode()
    if encoding == "binary":
        return header + rows.tobytes()
    raw = b"".join(np.ascontiguousarray(rows[name]).tobytes() for name in fields)
    packed = lzf_compress(raw)
    return header + struct.pack("<II", len(packed), len(raw)) + packed


def repr_number(value: Any) -> str:
    return f"{value:.17g}"


def ply(
    rows: NDArray[np.void], order: str, *, faces: list[list[int]], faces_first: bool = False
) -> bytes:
    """A PLY of a structured array, with a list element before or after the vertices."""
    names = {"f4": "float", "f8": "double", "u1": "uchar", "u4": "uint", "i2": "int16"}
    mark = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}[order]
    vertex = f"element vertex {len(rows)}\n" + "".join(
        f"property {names[rows.dtype[name].str[1:]]} {name}\n" for name in rows.dtype.names or ()
    )
    face = f"element face {len(faces)}\nproperty list uchar int vertex_indices\nproperty short id\n"
    if order == "ascii":
        body = "".join(" ".join(repr_number(v) for v in row.tolist()) + "\n" for row in rows)
        lists = "".join(f"{len(each)} {' '.join(map(str, each))} 7\n" for each in faces)
        parts = (body.encode(), lists.encode())
    else:
        swapped = rows.astype(rows.dtype.newbyteorder(mark))
        parts = (
            swapped.tobytes(),
            b"".join(struct.pack(f"{mark}B{len(each)}ih", len(each), *each, 7) for each in faces),
        )
    head = f"ply\nformat {order} 1.0\ncomment end_header is near\nobj_info none\n"
    elements = (face, vertex) if faces_first else (vertex, face)
    body_parts = parts[::-1] if faces_first else parts
    return (head + "".join(elements) + "end_header\n").encode() + b"".join(body_parts)


def vtk(points: Points, encoding: str) -> bytes:
    """A legacy VTK with something behind the points."""
    name = {"f4": "float", "f8": "double"}[points.dtype.str[1:]]
    head = f"# vtk DataFile Version 3.0\nPOINTS of interest\n{encoding}\nDATASET POLYDATA\n"
    head += f"POINTS {len(points)} {name}\n"
    if encoding == "BINARY":
        body = points.astype(points.dtype.newbyteorder(">")).tobytes()
    else:  # three points to a line, as VTK does
        words = [repr_number(value) for value in points.ravel()]
        body = "".join(" ".join(words[i : i + 9]) + " \n" for i in range(0, len(words), 9)).encode()
    return head.encode() + body + b"\nVERTICES 1 2\n1 0\n"


def las(points: Points, *, point_format: int, times: bool, compressed: bool) -> bytes:
    """A LAS or LAZ file of any point format, in steps of 1 mm."""
    import laspy

    version = "1.4" if point_format >= 6 else "1.2"
    header = laspy.LasHeader(version=version, point_format=point_format)
    header.scales, header.offsets = np.full(3, 0.001), np.array([1000.0, -2000.0, 30.0])
    data = laspy.LasData(header)
    data.xyz = points.astype(np.float64)
    if times:
        data.gps_time = np.arange(len(points)) * 0.25
    buffer = io.BytesIO()
    data.write(buffer, do_compress=compressed)
    return buffer.getvalue()


def npz(**arrays: NDArray[Any]) -> bytes:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return buffer.getvalue()


def npy(array: NDArray[Any]) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, array)
    return buffer.getvalue()


def csv(points: Points) -> bytes:
    rows = ["x,y,z"] + [",".join(repr_number(v) for v in row) for row in points]
    return ("\n".join(rows) + "\n").encode()


def samples(points: Points) -> dict[str, bytes]:
    """The same float32 points as a file of every kind; the key ends with the suffix."""
    plain = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4")])
    rows = np.ascontiguousarray(points, dtype="<f4").view(plain)[:, 0]
    four = np.zeros((len(points), 4), dtype="<f4")
    four[:, :3] = points
    faces = [[0, 1, 2], [0, 1, 2, 3], []]
    return {
        "kitti.bin": four.tobytes(),
        "ascii.pcd": pcd(rows, "ascii"),
        "binary.pcd": pcd(rows, "binary"),
        "compressed.pcd": pcd(rows, "binary_compressed"),
        "ascii.ply": ply(rows, "ascii", faces=faces),
        "little.ply": ply(rows, "binary_little_endian", faces=faces),
        "big.ply": ply(rows, "binary_big_endian", faces=faces, faces_first=True),
        "named.csv": csv(points),
        "ascii.vtk": vtk(points, "ASCII"),
        "binary.vtk": vtk(points, "BINARY"),
        "plain.las": las(points, point_format=0, times=False, compressed=False),
        "timed.las": las(points, point_format=7, times=True, compressed=False),
        "chunked.laz": las(points, point_format=1, times=True, compressed=True),
        "layered.laz": las(points, point_format=6, times=True, compressed=True),
        "array.npy": npy(points),
        "arrays.npz": npz(points=points, times=np.arange(len(points)) * 0.1),
        "plain.txt": csv(points)[6:].replace(b",", b" "),
        "plain.xyz": b"# a comment\n" + csv(points)[6:].replace(b",", b"\t"),
    }


def cloud(count: int = 50, seed: int = 0) -> np.ndarray[Any, np.dtype[np.float32]]:
    spread = [40.0, 30.0, 2.0]
    return (np.random.default_rng(seed).normal(size=(count, 3)) * spread).astype(np.float32)
