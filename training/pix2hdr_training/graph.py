"""A torch module from a layer graph: every operation of the weights format, version 1.

Tensors are [batch, channel, t, y, x] here ([t, y, x, c] in the format). Nets whose time is folded into channels
(T = 1, kernels [1, ky, kx]) run as 2D convolutions on channels-last tensors, which is much faster on a CPU.
"""

import math

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from . import layout
from .response import InverseResponse
from .tone import inverse_tone, tone

SATURATED = 0.98  # pixel value from which a pixel counts as saturated


def box_estimate(y: Tensor, exposure: Tensor, inverse: InverseResponse) -> Tensor:
    """The box filter on [..., y, x]: irradiance R⁻¹(y)/e, averaged over 3×3 with weights (1 2 1)ᵀ(1 2 1).

    Saturated pixels are left out unless all nine are; borders are mirrored (a size of 1 repeats).
    """
    irradiance = inverse(y) / exposure
    valid = (y < SATURATED).to(y.dtype)
    count = _binomial(valid)
    mean = _binomial(valid * irradiance) / count.clamp(min=1.0)
    if bool((count == 0).any()):
        mean = torch.where(count > 0, mean, _binomial(irradiance) / 16.0)
    return mean


def _binomial(x: Tensor) -> Tensor:
    """Σ over 3×3 neighbours with weights (1 2 1)ᵀ(1 2 1), borders mirrored."""
    for axis in (-2, -1):
        n = x.shape[axis]
        if n == 1:
            x = 4.0 * x
            continue
        total = 2.0 * x
        total.narrow(axis, 1, n - 1).add_(x.narrow(axis, 0, n - 1))
        total.narrow(axis, 0, n - 1).add_(x.narrow(axis, 1, n - 1))
        total.narrow(axis, 0, 1).add_(x.narrow(axis, 1, 1))
        total.narrow(axis, n - 1, 1).add_(x.narrow(axis, n - 2, 1))
        x = total
    return x


def fold(channels: list[Tensor], block) -> Tensor:
    """Blocks of [N, T, H, W] channels folded: out channel ((dt·by + dy)·bx + dx)·n + i; channels-last memory."""
    bt, by, bx = block
    batch, t, h, w = channels[0].shape
    x = torch.stack(channels, -1).reshape(batch, t // bt, bt, h // by, by, w // bx, bx, len(channels))
    x = x.permute(0, 1, 3, 5, 2, 4, 6, 7).reshape(batch, t // bt, h // by, w // bx, -1)
    return x.permute(0, 4, 1, 2, 3)


def unfold(x: Tensor, block) -> Tensor:
    """The inverse of `fold` with one channel: [N, bt·by·bx, T, H, W] → [N, T·bt, H·by, W·bx]."""
    bt, by, bx = block
    batch, _, t, h, w = x.shape
    x = x.reshape(batch, bt, by, bx, t, h, w).permute(0, 4, 1, 5, 2, 6, 3)
    return x.reshape(batch, t * bt, h * by, w * bx)


class Convolution(nn.Module):
    """`conv3d` or `conv_transpose3d` with its epilogue: activation, then norm, then add."""

    def __init__(self, node: dict, in_channels: int, *, feeds_unfold: bool = False, from_logs: bool = False):
        super().__init__()
        self.node = node
        self.kernel, self.stride = tuple(node["kernel"]), tuple(node["stride"])
        self.transposed = node["op"] == "conv_transpose3d"
        out = node["out_channels"]
        ends = (in_channels, out) if self.transposed else (out, in_channels)
        self.weight = nn.Parameter(torch.empty(*ends, *self.kernel))
        self.bias = nn.Parameter(torch.zeros(out))
        self.norm = nn.BatchNorm3d(out) if node.get("norm") else None
        self._initialise(in_channels, feeds_unfold, from_logs)

    def _initialise(self, in_channels: int, feeds_unfold: bool, from_logs: bool) -> None:
        # A transposed convolution's output sees only kernel/stride of the taps.
        taps = math.prod(self.kernel) / (math.prod(self.stride) if self.transposed else 1)
        gain = math.sqrt(2 / (1 + 0.2**2)) if isinstance(self.node["activation"], dict) else 1.0
        if feeds_unfold:
            gain = 0.01  # start as the box filter
        elif self.node.get("add"):
            gain = 0.2  # start near the identity
        nn.init.normal_(self.weight, std=gain / math.sqrt(in_channels * taps))
        if from_logs and in_channels > 1:
            # Log features are all near 0.8 and differ little: filters that sum to zero see the differences.
            with torch.no_grad():
                self.weight.sub_(self.weight.mean(0 if self.transposed else 1, keepdim=True))

    def forward(self, x: Tensor, add: Tensor | None) -> Tensor:
        kt, ky, kx = self.kernel
        if self.transposed:
            padding = tuple((k - s) // 2 for k, s in zip(self.kernel, self.stride, strict=True))
            v = F.conv_transpose3d(x, self.weight, self.bias, self.stride, padding)
        elif kt == 1 and x.shape[2] == 1:
            flat = F.conv2d(x.squeeze(2), self.weight.squeeze(2), self.bias, self.stride[1:], (ky // 2, kx // 2))
            v = flat.unsqueeze(2)
        else:
            v = F.conv3d(x, self.weight, self.bias, self.stride, (kt // 2, ky // 2, kx // 2))
        v = activate(v, self.node["activation"])
        if self.norm is not None:
            v = self.norm(v)
        return v if add is None else v + add


def activate(v: Tensor, activation) -> Tensor:
    """`"none"`, `"sigmoid"`, `{"leaky_relu": slope}` or `{"softplus": floor}`."""
    if activation == "none":
        return v
    if activation == "sigmoid":
        return torch.sigmoid(v)
    if isinstance(activation, dict) and len(activation) == 1:
        (kind, value), = activation.items()
        if kind == "leaky_relu":
            return F.leaky_relu(v, value)
        if kind == "softplus":
            return torch.logaddexp(v, torch.zeros_like(v)) + value
    raise layout.GraphError(f"activation {activation!r} is not known")


class GraphNet(nn.Module):
    """Runs a layer graph. In training mode `unfold` does not clamp, so that gradients pass."""

    def __init__(self, graph: dict, inverse: InverseResponse):
        super().__init__()
        self.graph, self.inverse = graph, inverse
        rows, columns = layout.granularity(graph)
        self.granularity = (rows, columns)
        known = layout.shapes(graph, rows, columns)
        logs = {
            node["name"]
            for node in graph["nodes"]
            if node["op"] == "features" and {"log_irradiance", "log_estimate"} & set(node["channels"])
        }
        tails = {node["inputs"][0] for node in graph["nodes"] if node["op"] == "unfold"}
        self.layers = nn.ModuleDict()
        for node in graph["nodes"]:
            if node["op"] in layout.CONVOLUTIONS:
                source = node["inputs"][0]
                self.layers[node["name"]] = Convolution(
                    node, known[source].c, feeds_unfold=node["name"] in tails, from_logs=source in logs
                )

    def forward(self, measurement: Tensor, exposure: Tensor, *, toned: bool = False, until: str | None = None):
        """The output node's tensor [N, C, T, H, W] for y [N, T, H, W] and e [N or 1, T, H, W].

        With `toned`, l of it (the output must be an `unfold` or a `fuse`); an `unfold` then skips the way to
        irradiance and back. With `until`, that node's tensor, and nothing behind it is computed.
        """
        graph = self.graph
        values = {"measurement": measurement.unsqueeze(1)}
        for node in graph["nodes"]:
            inputs = [values[name] for name in node["inputs"]]
            tone_it = toned and node["name"] == graph["output"]
            values[node["name"]] = self._node(node, inputs, values, exposure, tone_it)
            if node["name"] == until:
                break
        return values[until or graph["output"]]

    def _node(self, node: dict, inputs: list[Tensor], values: dict, exposure: Tensor, toned: bool) -> Tensor:
        op = node["op"]
        if op in layout.CONVOLUTIONS:
            add = values[node["add"]] if node.get("add") else None
            return self.layers[node["name"]](inputs[0], add)
        if op == "box_estimate":
            return box_estimate(inputs[0], exposure.unsqueeze(1), self.inverse)
        if op == "features":
            y, estimate = inputs[0][:, 0], inputs[1][:, 0]
            return fold([self._feature(name, y, estimate, exposure) for name in node["channels"]], node["block"])
        if op == "concat":
            return torch.cat(inputs, 1)
        if op == "inverse_response":
            e = torch.tensor(node["exposures"], dtype=inputs[0].dtype, device=inputs[0].device).view(-1, 1, 1, 1)
            return torch.cat([inputs[0], self.inverse(inputs[0]) / e], 1)
        if op == "fuse":
            weights, n = inputs[0], inputs[0].shape[1]
            fused = (weights * inputs[1][:, n:]).sum(1, keepdim=True) / weights.sum(1, keepdim=True)
            return tone(fused) if toned else fused
        if op == "unfold":
            d = unfold(inputs[0], node["block"]).unsqueeze(1).to(inputs[1].dtype)
            v = tone(inputs[1][:, :, node["start"] : node["start"] + d.shape[2]]) + d
            if not self.training:
                v = v.clamp(0.0, 1.0)
            return v if toned else inverse_tone(v)
        raise layout.GraphError(f"operation {op!r} is not known")

    def _feature(self, name: str, y: Tensor, estimate: Tensor, exposure: Tensor) -> Tensor:
        if name == "measurement":
            return y
        if name == "log_irradiance":
            return tone(self.inverse(y) / exposure)
        if name == "log_estimate":
            return tone(estimate)
        if name == "saturated":
            return (y >= SATURATED).to(y.dtype)
        if name == "log_exposure":
            return torch.log2(exposure).expand_as(y)
        raise layout.GraphError(f"feature {name!r} is not known")

    def result(self, output: Tensor) -> Tensor:
        """The result's `hop` frames, cut from an output of `frames` frames where need be."""
        window = self.graph["window"]
        if output.shape[2] == window["hop"] and output.shape[2] != window["frames"]:
            return output
        return output[:, :, window["lead"] : window["lead"] + window["hop"]]
