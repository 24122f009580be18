"""Weights files; half of the inputs are given the right hash, so that what is in them is read."""

from __future__ import annotations

import json
import struct

from common import Bench, fuzz, instrumented

with instrumented:
    from segloc.descriptors import pointset, profile, random_forest, segmap, weightfile
import numpy as np
from hostile.files import layers, network

bench = Bench("weights")
GEO = __import__("segloc.descriptors", fromlist=["create"]).create("geo", 1)
READERS = (
    pointset.load_weights,
    lambda path: profile.ProfileDescriptor(path, 1),
    segmap.load_weights,
    lambda path: random_forest.PairForest.load(path, GEO),
)


def hashed(data: bytes) -> bytes:
    """The same with the hash of what is in it, where there is a header at all."""
    try:
        (size,) = struct.unpack_from("<Q", data)
        header = json.loads(data[8 : 8 + size])
        metadata, tensors = header["__metadata__"], {}
        kinds = {"F32": "<f4", "I32": "<i4", "I8": "i1"}
        for name, entry in header.items():
            if name != "__metadata__":
                begin, end = entry["data_offsets"]
                values = np.frombuffer(data[8 + size :][begin:end], kinds[entry["dtype"]])
                tensors[name] = values.reshape(entry["shape"])
        metadata["sha256"] = weightfile.digest_of(tensors, json.loads(metadata["settings"]))
        text = json.dumps(header).encode()
    except Exception:  # no such file
        return data
    return struct.pack("<Q", len(text)) + text + data[8 + size :]


def read(data: bytes) -> None:
    which = data[0] if data else 0
    content = hashed(data[1:]) if which & 128 else data[1:]
    path = bench.file("last.safetensors", content)
    bench.run(path, lambda: READERS[which % len(READERS)](path))


def seeds() -> list[bytes]:
    forest = {"descriptor": GEO.fingerprint, "layout": '{"row": 1}'}
    files = (
        network("network", layers(), a=(1,)),
        network("profile network", {"profile": "1"}, weight0=(3, 2), bias0=(2,)),
        network("voxel network", {"preprocessing": "1"}, conv1=(3,)),
        network("forest", forest, roots=(1,), feature=(1,)),
    )
    return [bytes([128 + which]) + data for which, data in enumerate(files)]


if __name__ == "__main__":
    fuzz(read, seeds(), ("F32", "I32", "I8", "BF16", "data_offsets", "shape", "dtype", "neighbors"))
