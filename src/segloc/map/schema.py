"""Which tensors a map file has, and of what dtypes and shapes they are."""

from __future__ import annotations

from collections.abc import Mapping

from .contents import MAX_DIM

# Name -> dtype and shape. A letter stands for a length that must agree wherever it occurs.
SCHEMA: dict[str, tuple[str, tuple[str | int, ...]]] = {
    "origin": ("F64", (3,)),
    "centroids": ("F64", ("P", 3)),
    "stamps": ("F64", ("P",)),
    "trajectory": ("F64", ("V", 4, 4)),
    "vectors": ("F32", ("P", "D")),
    "quality": ("F32", ("P",)),
    "cloud": ("F32", ("N", 3)),
    "sizes": ("I32", ("P",)),
    "session": ("I32", ("P",)),
    "missed": ("I32", ("P",)),
}
OPTIONAL = frozenset({"quality", "missed"})


def shapes_fault(shapes: Mapping[str, tuple[str, list[int]]]) -> str | None:
    """What is wrong with the tensors of a file, by their dtypes and shapes; None if nothing is."""
    missing = SCHEMA.keys() - OPTIONAL - shapes.keys()
    unknown = shapes.keys() - SCHEMA.keys()
    if missing or unknown:
        fault = "lacks" if missing else "has unknown"
        return f"{fault} {', '.join(sorted(missing or unknown))}"
    lengths: dict[str, int] = {}
    for name, (dtype, shape) in shapes.items():
        wanted_dtype, wanted = SCHEMA[name]
        resolved = [lengths.get(d, d) if isinstance(d, str) else d for d in wanted]
        fits = len(shape) == len(wanted) and all(
            isinstance(w, str) or w == s for w, s in zip(resolved, shape, strict=True)
        )
        if dtype != wanted_dtype or not fits:
            text = ", ".join(str(d) for d in resolved)
            return f"{name} is {dtype} {tuple(shape)}, not {wanted_dtype} ({text})"
        for d, size in zip(wanted, shape, strict=True):
            if isinstance(d, str):
                lengths[d] = size
    if not 0 < lengths["D"] <= MAX_DIM:
        return f"vectors have {lengths['D']} numbers, not 1 to {MAX_DIM}"
    return None
