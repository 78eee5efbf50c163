"""The operations of the weights format, version 1: of each one, all that a layout and a net have to know.

Tensors are [batch, channel, t, y, x] here ([t, y, x, c] in the format), with the channels last in memory.
"""

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .response import InverseResponse
from .tone import inverse_tone, tone

SATURATED = 0.98  # pixel value from which a pixel counts as saturated
FEATURE_CHANNELS = ("measurement", "log_irradiance", "log_estimate", "saturated", "log_exposure")


class GraphError(ValueError):
    """A layer graph that breaks a rule of the weights format; the message names the node."""


@dataclass(frozen=True)
class Shape:
    """Frames, height, width and channels of a node's tensor."""

    t: int
    y: int
    x: int
    c: int

    @property
    def extent(self) -> tuple[int, int, int]:
        return self.t, self.y, self.x


def need(condition: bool, message: str) -> None:
    """Refuses a node."""
    if not condition:
        raise GraphError(message)


@dataclass
class Call:
    """Some frames of a node's result, and what they are made from."""

    node: dict
    values: dict  # Frames by name
    lengths: dict  # frames of the whole tensors
    exposure: Tensor
    inverse: InverseResponse
    layer: nn.Module | None
    first: int
    end: int
    toned: bool  # l of the result is wanted
    training: bool

    def frames(self, number: int = 0, first: int | None = None, end: int | None = None) -> Tensor:
        """Frames of an input: those of the result, or `first` … `end`."""
        return self.named(self.node["inputs"][number], first, end)

    def named(self, name: str, first: int | None = None, end: int | None = None) -> Tensor:
        first, end = self.first if first is None else first, self.end if end is None else end
        return self.values[name].cut(first, end, self.lengths[name])

    def exposures(self) -> Tensor:
        """Exposures of the result's frames."""
        return self.exposure[:, self.first : self.end].unsqueeze(1)


class Operation:
    """What stands here goes for an operation that computes each pixel of each frame from the same one of its inputs."""

    def span(self, node: dict, pixels: int, axis: int) -> int:
        """Pixels of the measurement along `axis` that a result spans whose first input spans `pixels`."""
        return pixels

    def shape(self, node: dict, inputs: list[Shape]) -> Shape:
        """Shape of the result; refuses inputs that do not fit."""
        return inputs[0]

    def reads(self, node: dict, number: int, first: int, end: int) -> tuple[int, int]:
        """Frames of input `number` that frames `first` … `end` of the result depend on; they may lie outside."""
        return first, end

    def compute(self, call: Call) -> Tensor:
        """The result."""
        raise NotImplementedError


class BoxEstimate(Operation):
    def shape(self, node, inputs):
        need(node["inputs"] == ["measurement"], "takes `measurement`")
        return inputs[0]

    def compute(self, call):
        return box_estimate(call.frames(), call.exposures(), call.inverse)


class LogIrradiance(Operation):
    def shape(self, node, inputs):
        need(node["inputs"] == ["measurement"], "takes `measurement`")
        return inputs[0]

    def compute(self, call):
        return tone(call.inverse(call.frames()) / call.exposures())


class Features(Operation):
    def span(self, node, pixels, axis):
        return pixels * node["block"][axis]

    def shape(self, node, inputs):
        first, (bt, by, bx) = inputs[0], node["block"]
        need(len(inputs) in (2, 3) and node["inputs"][0] == "measurement", "takes `measurement` and an estimate")
        need(all(i == first for i in inputs), "its inputs differ in shape")
        need(len(inputs) == 3 or not node.get("neighbours"), "neighbours are those of a log_irradiance")
        need(first.t % bt == 0 and first.y % by == 0 and first.x % bx == 0, "the block does not divide the input")
        channels = len(node["channels"]) + len(node.get("neighbours", ()))
        return Shape(first.t // bt, first.y // by, first.x // bx, channels * bt * by * bx)

    def reads(self, node, number, first, end):
        bt = node["block"][0]
        offsets = [0, *node.get("neighbours", ())] if number == 2 else [0]
        return first * bt + min(offsets), end * bt + max(offsets)

    def compute(self, call):
        node, bt = call.node, call.node["block"][0]
        first, end = call.first * bt, call.end * bt

        def frames(number: int, offset: int = 0) -> Tensor:
            return call.frames(number, first + offset, end + offset)[:, 0]

        y, e = frames(0), call.exposure[:, first:end]
        has_logs = len(node["inputs"]) == 3

        def channel(name: str) -> Tensor:
            if name == "measurement":
                return y
            if name == "log_irradiance":
                return frames(2) if has_logs else tone(call.inverse(y) / e)
            if name == "log_estimate":
                return tone(frames(1))
            if name == "saturated":
                return (y >= SATURATED).to(y.dtype)
            if name == "log_exposure":
                return torch.log2(e).expand_as(y)
            raise GraphError(f"feature {name!r} is not known")

        channels = [channel(name) for name in node["channels"]]
        channels += [frames(2, offset) for offset in node.get("neighbours", ())]
        return fold(channels, node["block"])


class Conv3d(Operation):
    def span(self, node, pixels, axis):
        return pixels * node["stride"][axis]

    def shape(self, node, inputs):
        need(all(k % 2 == 1 for k in node["kernel"]), "the kernel must be odd")
        extent = (-(-n // s) for n, s in zip(inputs[0].extent, node["stride"], strict=True))
        return Shape(*extent, node["out_channels"])

    def reads(self, node, number, first, end):
        k, s = node["kernel"][0], node["stride"][0]
        return first * s - k // 2, (end - 1) * s - k // 2 + k

    def compute(self, call):
        node, source = call.node, call.node["inputs"][0]
        add = call.named(node["add"]) if node.get("add") else None
        return call.layer(call.values[source], call.first, call.end, call.lengths[source], add)


class ConvTranspose3d(Conv3d):
    def span(self, node, pixels, axis):
        return max(1, pixels // node["stride"][axis])

    def shape(self, node, inputs):
        fits = all(k >= s and (k - s) % 2 == 0 for k, s in zip(node["kernel"], node["stride"], strict=True))
        need(fits, "kernel − stride must be even")
        extent = (n * s for n, s in zip(inputs[0].extent, node["stride"], strict=True))
        return Shape(*extent, node["out_channels"])

    def reads(self, node, number, first, end):
        k, s = node["kernel"][0], node["stride"][0]
        padding = (k - s) // 2
        return -((k - 1 - padding - first) // s), (end - 1 + padding) // s + 1


class Concat(Operation):
    def shape(self, node, inputs):
        need(all(i.extent == inputs[0].extent for i in inputs), "inputs differ in size")
        need(all(i.c % 4 == 0 for i in inputs[:-1]), "all inputs but the last need a multiple of 4 channels")
        return Shape(*inputs[0].extent, sum(i.c for i in inputs))

    def compute(self, call):
        return torch.cat([call.named(name) for name in call.node["inputs"]], 1)


class InverseResponseOf(Operation):
    def shape(self, node, inputs):
        need(len(node["exposures"]) == inputs[0].c, "one exposure for each channel")
        return Shape(*inputs[0].extent, 2 * inputs[0].c)

    def compute(self, call):
        y = call.frames()
        e = torch.tensor(call.node["exposures"], dtype=y.dtype, device=y.device).view(-1, 1, 1, 1)
        return torch.cat([y, call.inverse(y) / e], 1)


class Fuse(Operation):
    def shape(self, node, inputs):
        fits = len(inputs) == 2 and inputs[1] == Shape(*inputs[0].extent, 2 * inputs[0].c)
        need(fits, "takes n weights and 2n channels")
        return Shape(*inputs[0].extent, 1)

    def compute(self, call):
        weights, rendered = call.frames(0), call.frames(1)
        n = weights.shape[1]
        fused = (weights * rendered[:, n:]).sum(1, keepdim=True) / weights.sum(1, keepdim=True)
        return tone(fused) if call.toned else fused


class Blend(Operation):
    """In training mode it does not clamp, so that gradients pass. Where l of the result is wanted, it skips the way to
    irradiance and back.
    """

    def span(self, node, pixels, axis):
        return max(1, pixels // node["block"][axis])

    def shape(self, node, inputs):
        weights, (bt, by, bx) = inputs[0], node["block"]
        need(bt == 1 and weights.c == by * bx * (len(node["taps"]) + 1), "the block does not fit the channels")
        shape = Shape(weights.t, weights.y * by, weights.x * bx, 1)
        need(inputs[1:] == [shape, shape], "log irradiance and estimate do not fit the weights")
        return shape

    def reads(self, node, number, first, end):
        offsets = [0, *(tap[0] for tap in node["taps"])] if number == 1 else [0]
        return first + min(offsets), end + max(offsets)

    def compute(self, call):
        v = self._log(call, call.frames(0), tone(call.frames(2)))
        if not call.training:
            v = v.clamp(0.0, 1.0)
        return v if call.toned else inverse_tone(v)

    def _log(self, call: Call, x: Tensor, base: Tensor) -> Tensor:
        """base + Σ w·(log irradiance of the tap − base) + d, with the weights and the residual of each pixel in x."""
        node = call.node
        logs, (_, by, bx), n = call.values[node["inputs"][1]], node["block"], len(node["taps"])
        # Blocks stay folded until all taps are summed: [N, T, H/by, W/bx, n + 1, by·bx], as it lies in memory.
        x = x.permute(0, 2, 3, 4, 1).unflatten(-1, (n + 1, by * bx))
        differences = x.new_empty(*x.shape[:4], n, by * bx)
        for i, tap in enumerate(node["taps"]):
            value, inside = shifted(logs.tensor[:, 0], call.first - logs.first, x.shape[1], tap)
            differences[..., i, :] = fold([value - inside * base[:, 0]], node["block"]).permute(0, 2, 3, 4, 1)
        wide = torch.promote_types(x.dtype, torch.float32)
        d = (x[..., :n, :] * differences).sum(-2, dtype=wide) + x[..., n, :]
        return base + unfold(d.permute(0, 4, 1, 2, 3), node["block"])


OPERATIONS: dict[str, Operation] = {
    "box_estimate": BoxEstimate(),
    "log_irradiance": LogIrradiance(),
    "features": Features(),
    "conv3d": Conv3d(),
    "conv_transpose3d": ConvTranspose3d(),
    "concat": Concat(),
    "inverse_response": InverseResponseOf(),
    "fuse": Fuse(),
    "blend": Blend(),
}


def operation(node: dict) -> Operation:
    """The operation of a node."""
    if node["op"] not in OPERATIONS:
        raise GraphError(f"node {node['name']!r}: operation {node['op']!r} is not known")
    return OPERATIONS[node["op"]]


def box_estimate(y: Tensor, exposure: Tensor, inverse: InverseResponse) -> Tensor:
    """The box filter on [..., y, x]: irradiance R⁻¹(y)/e, averaged over 3×3 with weights (1 2 1)ᵀ(1 2 1).

    Saturated pixels are left out unless all nine are; borders are mirrored (a size of 1 repeats).
    """
    irradiance = inverse(y) / exposure
    valid = (y < SATURATED).to(y.dtype)
    count = _binomial(valid)
    mean = _binomial(valid * irradiance) / count.clamp(min=1.0)
    if torch.compiler.is_exporting() or bool((count == 0).any()):  # an exported net can't branch on values
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
    """Channels unfolded into pixels: [N, n·by·bx, T, H, W] → [N, n, T, H·by, W·bx], in channel (i·by + dy)·bx + dx."""
    _, by, bx = block
    batch, _, t, h, w = x.shape
    x = x.reshape(batch, -1, by, bx, t, h, w).permute(0, 1, 4, 5, 2, 6, 3)
    return x.reshape(batch, -1, t, h * by, w * bx)


def shifted(video: Tensor, first: int, frames: int, tap) -> tuple[Tensor, Tensor]:
    """A video [N, T, H, W] at the offset `tap` (t, y, x) from its frames `first` … `first + frames`, and where that is inside.

    Outside it is 0.
    """
    extent = (frames, *video.shape[2:])
    value, inside = video.new_zeros(len(video), *extent), video.new_zeros(1, *extent)
    # Along each axis, the positions whose tap lies inside, and their taps.
    here, there = [slice(None)], [slice(None)]
    for offset, size, count in zip((first + tap[0], *tap[1:]), video.shape[1:], extent, strict=True):
        begin = max(0, -offset)
        end = max(begin, min(count, size - offset))
        here.append(slice(begin, end))
        there.append(slice(begin + offset, end + offset))
    if all(s.start < s.stop for s in here[1:]):
        value[tuple(here)] = video[tuple(there)]
        inside[tuple(here)] = 1.0
    return value, inside


class Convolution(nn.Module):
    """`conv3d` or `conv_transpose3d` with its epilogue: activation, then norm, then add."""

    def __init__(self, node: dict, in_channels: int, *, is_tail: bool = False, from_logs: bool = False):
        super().__init__()
        self.node = node
        self.kernel, self.stride = tuple(node["kernel"]), tuple(node["stride"])
        self.transposed = node["op"] == "conv_transpose3d"
        out = node["out_channels"]
        ends = (in_channels, out) if self.transposed else (out, in_channels)
        self.weight = nn.Parameter(torch.empty(*ends, *self.kernel))
        self.bias = nn.Parameter(torch.zeros(out))
        self.norm = nn.BatchNorm3d(out) if node.get("norm") else None
        # A transposed convolution's output sees only kernel/stride of the taps.
        taps = math.prod(self.kernel) / (math.prod(self.stride) if self.transposed else 1)
        self.fan_in = in_channels * taps
        self._initialise(in_channels, is_tail, from_logs)

    def _initialise(self, in_channels: int, is_tail: bool, from_logs: bool) -> None:
        gain = math.sqrt(2 / (1 + 0.2**2)) if isinstance(self.node["activation"], dict) else 1.0
        if is_tail:
            gain = 0.01  # start as the box filter
        elif self.node.get("add"):
            gain = 0.2  # start near the identity
        nn.init.normal_(self.weight, std=gain / math.sqrt(self.fan_in))
        if from_logs and in_channels > 1:
            # Log features are all near 0.8 and differ little: filters that sum to zero see the differences.
            with torch.no_grad():
                self.weight.sub_(self.weight.mean(0 if self.transposed else 1, keepdim=True))

    def forward(self, x: "Frames", first: int, end: int, total: int, add: Tensor | None) -> Tensor:
        """Frames `first` … `end` of the result; `total` is the length of the whole input in frames."""
        (kt, ky, kx), (st, sy, sx) = self.kernel, self.stride
        if not self.transposed:
            seen = x.cut(first * st - kt // 2, (end - 1) * st - kt // 2 + kt, total)
            by_frame = seen.device.type == "cpu" and not has_matrix_unit()
            v = self._by_frame(seen, end - first) if by_frame else F.conv3d(
                seen, self.weight.to(memory_format=torch.channels_last_3d), self.bias, self.stride, (0, ky // 2, kx // 2)
            )
        elif self.kernel == self.stride and kt == 1:
            v = self._shuffled(x.cut(first, end, total))
        else:
            padding = tuple((k - s) // 2 for k, s in zip(self.kernel, self.stride, strict=True))
            begin = -((kt - 1 - padding[0] - first) // st)
            seen = x.cut(begin, (end - 1 + padding[0]) // st + 1, total)
            v = F.conv_transpose3d(seen, self.weight, self.bias, self.stride, (0, *padding[1:]))
            v = v[:, :, first + padding[0] - begin * st :][:, :, : end - first]
        v = activate(v, self.node["activation"])
        if self.norm is not None:
            v = self.norm(v)
        return v if add is None else v + add

    def _by_frame(self, x: Tensor, frames: int) -> Tensor:
        """The convolution as one of images whose channels are those of all taps in time: far faster in f32 on a CPU."""
        kt, ky, kx = self.kernel
        st = self.stride[0]
        x = x.transpose(1, 2)  # [N, T, C, H, W], with the channels last in memory
        taps = [x[:, t : t + (frames - 1) * st + 1 : st] for t in range(kt)]
        images = (torch.cat(taps, 2) if kt > 1 else taps[0]).flatten(0, 1)
        weight = self.weight.transpose(1, 2).flatten(1, 2)
        v = F.conv2d(images, weight, self.bias, self.stride[1:], (ky // 2, kx // 2))
        return v.unflatten(0, (x.shape[0], frames)).transpose(1, 2)

    def _shuffled(self, x: Tensor) -> Tensor:
        """A transposed convolution whose taps do not overlap: one matrix product, then blocks of pixels."""
        _, sy, sx = self.stride
        n, _, t, h, w = x.shape
        v = torch.einsum("ncthw,coyx->nthywxo", x, self.weight.squeeze(2)) + self.bias
        return v.reshape(n, t, h * sy, w * sx, -1).permute(0, 4, 1, 2, 3)


def has_matrix_unit() -> bool:
    """Whether the CPU computes in bfloat16 in a matrix unit (AMX), which takes 3D convolutions as they are."""
    return torch.is_autocast_enabled("cpu") and torch.cpu._is_amx_tile_supported()


class Frames:
    """Some frames of a node's tensor [N, C, T, H, W]; `first` is the number of the first one."""

    def __init__(self, tensor: Tensor, first: int = 0):
        self.tensor, self.first = tensor, first

    def cut(self, first: int, end: int, total: int) -> Tensor:
        """Frames `first` … `end`, with zeros for those before the window and behind its `total` frames."""
        inside = max(0, min(first, total)), max(0, min(end, total))
        kept = self.tensor[:, :, inside[0] - self.first : inside[1] - self.first]
        before = min(max(0, -first), end - first)
        behind = end - first - before - kept.shape[2]
        return F.pad(kept, (0, 0, 0, 0, before, behind)) if before or behind else kept


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
    raise GraphError(f"activation {activation!r} is not known")
