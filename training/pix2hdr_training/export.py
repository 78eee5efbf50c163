"""Writing and reading weights files (weights-format/README.md)."""

import json
import os
import struct
from pathlib import Path

import numpy as np
import torch
from safetensors import safe_open
from safetensors.numpy import save

from .graph import GraphNet
from .layout import tensor_shapes
from .response import InverseResponse

FORMAT = "pix2hdr-weights/1"


def tensors_of(net: GraphNet) -> dict[str, np.ndarray]:
    """The net's tensors by their names in the format, float64; batch norm becomes scale and shift."""
    tensors = {}
    for name, layer in net.layers.items():
        values = {"weight": layer.weight, "bias": layer.bias}
        norm = layer.norm
        if norm is not None:
            scale = norm.weight.double() / (norm.running_var.double() + norm.eps).sqrt()
            values["scale"] = scale
            values["shift"] = norm.bias.double() - norm.running_mean.double() * scale
        for key, value in values.items():
            tensors[f"{name}.{key}"] = value.detach().double().cpu().numpy()
    return tensors


def write_weights(path, net: GraphNet, graph: dict | None = None, *, response="any", provenance: dict | None = None, half: bool = False) -> None:
    """Writes a weights file, F32 or (`half`) F16, by way of a temporary file.

    `graph` stands in for the net's own where it differs in its window. `response` is "any" or a response as in `capture.json`.
    Raises ValueError where a tensor is not finite in the chosen type, or not what the graph says.
    """
    kind = np.float16 if half else np.float32
    expected = tensor_shapes(net.graph)
    with np.errstate(over="ignore"):
        tensors = {name: value.astype(kind) for name, value in tensors_of(net).items()}
    for name, shape in expected.items():
        if tensors[name].shape != shape:
            raise ValueError(f"{name}: shape {tensors[name].shape}, expected {shape}")
        if not np.all(np.isfinite(tensors[name])):
            raise ValueError(f"{name}: not finite as {np.dtype(kind)}")
    metadata = {
        "format": FORMAT,
        "graph": json.dumps(graph or net.graph),
        "response": json.dumps(response),
        "provenance": json.dumps(provenance or {}),
    }
    write_atomically(path, canonical(save(tensors, metadata)))


def canonical(data: bytes) -> bytes:
    """The same safetensors file with its metadata sorted by key: the library's order changes from run to run."""
    (length,) = struct.unpack("<Q", data[:8])
    header = json.loads(data[8 : 8 + length])
    if "__metadata__" in header:
        header["__metadata__"] = dict(sorted(header["__metadata__"].items()))
    text = json.dumps(header, separators=(",", ":"), ensure_ascii=False).encode()
    text += b" " * (-len(text) % 8)
    return struct.pack("<Q", len(text)) + text + data[8 + length :]


def write_atomically(path, data: bytes) -> None:
    """Writes a file under a temporary name and renames it."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(path.name + ".part")
    temporary.write_bytes(data)
    os.replace(temporary, path)


def read_weights(path) -> tuple[dict, dict[str, np.ndarray], dict]:
    """(graph, tensors, metadata) of a weights file, after checking names, shapes and finiteness."""
    with safe_open(str(path), framework="numpy") as file:
        metadata = file.metadata() or {}
        if metadata.get("format") != FORMAT:
            raise ValueError(f"{path}: not a {FORMAT} file")
        tensors = {name: file.get_tensor(name) for name in file.keys()}
    graph = json.loads(metadata["graph"])
    expected = tensor_shapes(graph)
    if set(expected) != set(tensors):
        raise ValueError(f"{path}: tensors missing or unknown: {sorted(set(expected) ^ set(tensors))}")
    for name, shape in expected.items():
        if tensors[name].shape != shape or not np.all(np.isfinite(tensors[name])):
            raise ValueError(f"{path}: {name} has shape {tensors[name].shape}, expected {shape}, or is not finite")
    return graph, tensors, metadata


def trainable_state(path) -> tuple[dict[str, torch.Tensor], dict]:
    """State of a `GraphNet` to train on from a weights file, and the file's provenance.

    ValueError for nets with batch norm: the file holds scale and shift, not the statistics that training would go on with.
    """
    graph, tensors, metadata = read_weights(path)
    if any(name.endswith(".scale") for name in tensors):
        raise ValueError("a weights file says too little of batch norm to train on; take the run's checkpoint")
    net = GraphNet(graph, InverseResponse.of_linear(1.0))  # its response is no part of the state
    _put(net, tensors)
    return net.state_dict(), json.loads(metadata.get("provenance", "{}"))


def net_from_weights(path, inverse: InverseResponse, window: dict | None = None) -> GraphNet:
    """The net of a weights file, in eval mode; meant for running it, not for training on.

    `window` stands in for the graph's, for nets whose lead is all that they reach in time.
    """
    graph, tensors, _ = read_weights(path)
    net = GraphNet({**graph, "window": window or graph["window"]}, inverse)
    _put(net, tensors)
    for layer in net.layers.values():
        if layer.norm is not None:
            # Mean 0, variance 1, ε 0: the norm is exactly v·scale + shift.
            layer.norm.eps = 0.0
            layer.norm.running_var.fill_(1.0)
    return net.eval()


@torch.no_grad()
def _put(net: GraphNet, tensors: dict[str, np.ndarray]) -> None:
    """A weights file's tensors in a net of its graph; norms with mean 0 and variance + ε = 1 are v·scale + shift."""
    for name, layer in net.layers.items():
        layer.weight.copy_(torch.from_numpy(tensors[f"{name}.weight"]))
        layer.bias.copy_(torch.from_numpy(tensors[f"{name}.bias"]))
        if layer.norm is not None:
            layer.norm.running_var.fill_(1.0 - layer.norm.eps)
            layer.norm.weight.copy_(torch.from_numpy(tensors[f"{name}.scale"]))
            layer.norm.bias.copy_(torch.from_numpy(tensors[f"{name}.shift"]))

