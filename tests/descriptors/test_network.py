"""Native inference against PyTorch, layer by layer, and the weight files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import save_file
from samples.segments import packed

from segloc import _native
from segloc.descriptors import create
from segloc.descriptors.pointset import (
    DSM_LAYERS,
    Layer,
    PointSetDescriptor,
    load_weights,
)
from segloc.errors import WeightsError

torch = pytest.importorskip("torch")
export = pytest.importorskip("segloc_lab.training.models")
models = pytest.importorskip("segloc_lab.training.models")

from segloc_lab.training.config import HeadKind  # noqa: E402
from segloc_lab.training.pair_fitting import PairHead  # noqa: E402
from segloc_lab.training.writing import write_network  # noqa: E402

torch.set_num_threads(1)  # small problems: more threads only wait for each other

ODD_LAYERS = (Layer(70, 7, 2, 20), Layer(33, 9, 3, 24), Layer(5, 11, 2, 36))
TABLES = {**models.LAYERS, "odd": ODD_LAYERS}
POINTS = {"dsm": 256, "esm": 256, "odd": 100}


def prepared(count: int, points: int = 256, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    cloud = rng.normal(size=(count * 300, 3)).astype(np.float32) * np.float32([3, 1, 1])
    offsets = np.arange(count + 1, dtype=np.int64) * 300
    return _native.prepare_segments(cloud, offsets, points)


def random_model(name: str, seed: int = 0) -> models.DescriptorNetwork:
    """A network whose batch norms do something."""
    torch.manual_seed(seed)
    model = models.DescriptorNetwork(TABLES[name])
    with torch.no_grad():
        for module in model.modules():
            if isinstance(module, models.Norm):
                module.running_mean.normal_(0, 0.3)
                module.running_var.uniform_(0.3, 2)
                module.weight.uniform_(0.5, 1.5)
                module.bias.normal_(0, 0.3)
        model.quality_head.weight.normal_(0, 0.1)
    return model.eval()


def native(model: models.DescriptorNetwork, points: int, isa: str = "auto") -> _native.Network:
    table = [(x.points, x.neighbors, x.dilation, x.channels) for x in model.layers]
    return _native.Network(table, export.folded(model), points, isa)


def relative_error(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.abs(a - b).max() / np.abs(b).max())


@pytest.mark.parametrize("isa", ["portable", "avx2", "avx512"])
@pytest.mark.parametrize("name", ["dsm", "esm", "odd"])
def test_inference_equals_pytorch(name: str, isa: str) -> None:
    try:
        _native.instruction_set(isa)
    except ValueError as error:
        pytest.skip(str(error))
    model, segments = random_model(name), prepared(3 if name == "esm" else 11, POINTS[name])
    network = native(model, POINTS[name], isa)
    with torch.no_grad():
        points = torch.from_numpy(segments)
        activations = model.activations(points)
        vectors = model(points)
        quality = model.quality(vectors)
    for layer, expected in enumerate(activations):
        found = network.activations(segments, layer)
        assert relative_error(found, expected.numpy()) < 1e-5, f"layer {layer}"
    found, found_quality = network.describe(segments, 1)
    assert relative_error(found, vectors.numpy()) < 1e-5
    np.testing.assert_allclose(found_quality, quality.numpy(), atol=1e-5)


def test_dilated_neighbours_are_exact() -> None:
    segments = prepared(4)
    segments[0, 50:] = segments[0, np.arange(206) % 50]  # repeated points tie
    for sources, queries, k, dilation in ((256, 160, 8, 1), (160, 96, 10, 2), (96, 16, 12, 3)):
        source = segments[:, :sources]
        d = source[:, None] - segments[:, :queries, None]
        squared = (d[..., 0] * d[..., 0] + d[..., 1] * d[..., 1]) + d[..., 2] * d[..., 2]
        expected = np.argsort(squared, axis=-1, kind="stable")[..., : k * dilation : dilation]
        for isa in ("portable", "auto"):
            found = _native.dilated_neighbors(segments, sources, queries, k, dilation, 1, isa)
            np.testing.assert_array_equal(found, expected)


def write(path: Path, change: str) -> None:
    """A weights file with one fault."""
    tensors = export.folded(random_model("dsm"))
    if change == "missing tensor":
        del tensors["fc2.weight"]
    if change == "wrong shape":
        tensors["layers.1.x0.weight"] = tensors["layers.1.x0.weight"][:, :-1]
    if change == "not finite":
        tensors["fc1.weight"][3, 5] = np.nan
    layers = [Layer(160, 8, 64, 32), *DSM_LAYERS[1:]] if change == "bad table" else DSM_LAYERS
    write_network(path, tensors, layers, "pca2d", {"data": "test"})
    if change == "truncated":
        path.write_bytes(path.read_bytes()[:-1000])
    if change == "garbage":
        path.write_bytes(b"\xff" * 500)
    if change == "altered":
        content = bytearray(path.read_bytes())
        content[-1] ^= 1
        path.write_bytes(bytes(content))
    if change == "other format":
        save_file(tensors, path, {"format": "pt"})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("missing tensor", "'fc2.weight' is missing"),
        ("wrong shape", "'layers.1.x0.weight' has shape"),
        ("not finite", "'fc1.weight' has values that are not finite"),
        ("bad table", "layer table"),
        ("truncated", "safetensors"),
        ("garbage", "safetensors"),
        ("altered", "do not match their hash"),
        ("other format", "not a network"),
    ],
)
def test_damaged_weights_are_refused(tmp_path: Path, change: str, message: str) -> None:
    path = tmp_path / "network.safetensors"
    write(path, change)
    with pytest.raises(WeightsError, match=message) as caught:
        load_weights(path)
    text = str(caught.value)
    assert text.startswith(str(path)) and "\n" not in text


def test_weights_round_trip(tmp_path: Path) -> None:
    path = tmp_path / "network.safetensors"
    model, card = random_model("dsm"), {"data": "a test", "licence": "MIT"}
    export.export(model, path, card)
    weights = load_weights(path)
    assert weights.card == card
    segments = prepared(5)
    expected, _ = native(model, 256).describe(segments)
    np.testing.assert_array_equal(weights.network.describe(segments)[0], expected)


@pytest.mark.parametrize("kind", ["linear", "two_layer"])
def test_fc4_travels_with_the_weights_and_changes_no_descriptor(
    kind: HeadKind, tmp_path: Path
) -> None:
    without, path = tmp_path / "without.safetensors", tmp_path / "with.safetensors"
    model = random_model("dsm")
    model.pair_head = PairHead(kind, 16)
    export.export(model, without, {})
    export.export(model, path, {}, with_pairs=True)
    plain, results = (
        PointSetDescriptor("dsm", without),
        PointSetDescriptor("fq", path, judge="pair"),
    )
    assert plain.fingerprint == results.fingerprint  # maps stay valid
    assert plain.pruner is None and results.pruner is not None
    assert not results.rates and results.encode(prepared(3)).quality is None
    with pytest.raises(WeightsError, match="no FC4, which fq needs"):
        PointSetDescriptor("fq", without, judge="pair")
    a, b = np.random.default_rng(0).normal(size=(2, 30, 16)).astype(np.float32)
    index = np.arange(30)
    likely = results.pruner.probability(a, b, index, index[::-1])
    with torch.inference_mode():
        logits = model.pair_logits(torch.from_numpy(a), torch.from_numpy(b[::-1].copy()))
    np.testing.assert_allclose(likely, torch.sigmoid(logits).numpy(), atol=1e-6)
    np.testing.assert_array_equal(  # of all pairs together or of one
        results.pruner.probability(a, b, index[:1], index[::-1][:1]), likely[:1]
    )


@pytest.mark.parametrize(
    ("tensors", "fault"),
    [
        ({"pair.0.weight": (16, 1)}, "FC4 has the tensors pair.0.weight"),
        ({"pair.0.weight": (15, 1), "pair.0.bias": (1,)}, "15 inputs for descriptors of 16"),
        ({"pair.0.weight": (16, 2), "pair.0.bias": (2,)}, "2 outputs, not 1"),
    ],
)
def test_a_damaged_fc4_is_named(
    tensors: dict[str, tuple[int, ...]], fault: str, tmp_path: Path
) -> None:
    path = tmp_path / "network.safetensors"
    model = random_model("dsm")
    pairs = {name: np.ones(shape, np.float32) for name, shape in tensors.items()}
    write_network(path, {**export.folded(model), **pairs}, model.layers, "pca2d", {})
    with pytest.raises(WeightsError, match=fault):
        load_weights(path)


def test_shipped_descriptor() -> None:
    """Loads, knows where it comes from, and describes as the variant without quality."""
    descriptor = create("dsm-nq", threads=1)
    assert isinstance(descriptor, PointSetDescriptor) and descriptor.rates
    assert {"data", "command", "figures", "licence"} <= set(descriptor.card)
    json.dumps(descriptor.card)
    points = np.random.default_rng(4).gamma(2.0, 1.0, (400, 3)) * [3, 1, 1]
    segments = packed([points])
    plain = create("dsm", threads=2)
    assert plain.fingerprint == descriptor.fingerprint
    rated, bare = (each.describe(segments) for each in (descriptor, plain))
    assert rated.quality is not None and bare.quality is None
    np.testing.assert_array_equal(rated.vectors, bare.vectors)
