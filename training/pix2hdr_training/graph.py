"""A torch module from a layer graph: every operation of the weights format, version 1.

Tensors are [batch, channel, t, y, x] here ([t, y, x, c] in the format), with the channels last in memory. Only those
frames of a node are computed that the result depends on.
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
    raise layout.GraphError(f"activation {activation!r} is not known")


class GraphNet(nn.Module):
    """Runs a layer graph. In training mode `blend` does not clamp, so that gradients pass."""

    def __init__(self, graph: dict, inverse: InverseResponse):
        super().__init__()
        self.graph, self.inverse = graph, inverse
        rows, columns = layout.granularity(graph)
        self.granularity = (rows, columns)
        known = layout.shapes(graph, rows, columns)
        self.frames = {name: shape.t for name, shape in known.items()}
        logs = {
            node["name"]
            for node in graph["nodes"]
            if node["op"] == "features" and {"log_irradiance", "log_estimate"} & set(node["channels"])
        }
        tails = {node["inputs"][0] for node in graph["nodes"] if node["op"] == "blend"}
        self.layers = nn.ModuleDict()
        for node in graph["nodes"]:
            if node["op"] in layout.CONVOLUTIONS:
                source = node["inputs"][0]
                self.layers[node["name"]] = Convolution(
                    node, known[source].c, is_tail=node["name"] in tails, from_logs=source in logs
                )

    def forward(self, measurement: Tensor, exposure: Tensor, *, toned: bool = False, until: str | None = None):
        """The output node's tensor [N, C, T, H, W] for y [N, T, H, W] and e [N or 1, T, H, W].

        Of a node that spans the window, it holds the result's frames alone: nothing else is computed. With `toned`,
        l of it (the output must be a `blend` or a `fuse`); a `blend` then skips the way to irradiance and back. With `until`, that node's tensor.
        """
        graph, output = self.graph, until or self.graph["output"]
        needed = layout.needed_frames(graph, output)
        values = {"measurement": Frames(measurement.unsqueeze(1))}
        for node in graph["nodes"]:
            name = node["name"]
            if name in needed:
                values[name] = Frames(self._node(node, values, exposure, *needed[name], toned and name == output), needed[name][0])
        return values[output].tensor

    def _node(self, node: dict, values: dict, exposure: Tensor, first: int, end: int, toned: bool) -> Tensor:
        op = node["op"]

        def frames(name: str, start: int = first, stop: int = end) -> Tensor:
            return values[name].cut(start, stop, self.frames[name])

        source = node["inputs"][0]
        if op in layout.CONVOLUTIONS:
            add = frames(node["add"]) if node.get("add") else None
            return self.layers[node["name"]](values[source], first, end, self.frames[source], add)
        if op == "box_estimate":
            return box_estimate(frames(source), exposure[:, first:end].unsqueeze(1), self.inverse)
        if op == "log_irradiance":
            return tone(self.inverse(frames(source)) / exposure[:, first:end].unsqueeze(1))
        if op == "features":
            return self._features(node, values, exposure, first, end)
        if op == "concat":
            return torch.cat([frames(name) for name in node["inputs"]], 1)
        if op == "inverse_response":
            y = frames(source)
            e = torch.tensor(node["exposures"], dtype=y.dtype, device=y.device).view(-1, 1, 1, 1)
            return torch.cat([y, self.inverse(y) / e], 1)
        if op == "fuse":
            weights, rendered = (frames(name) for name in node["inputs"])
            n = weights.shape[1]
            fused = (weights * rendered[:, n:]).sum(1, keepdim=True) / weights.sum(1, keepdim=True)
            return tone(fused) if toned else fused
        if op == "blend":
            v = self._blended(node, frames(source), tone(frames(node["inputs"][2])), values, first)
            if not self.training:
                v = v.clamp(0.0, 1.0)
            return v if toned else inverse_tone(v)
        raise layout.GraphError(f"operation {op!r} is not known")

    def _blended(self, node: dict, x: Tensor, base: Tensor, values: dict, first: int) -> Tensor:
        """base + Σ w·(log irradiance of the tap − base) + d, with the weights and the residual of each pixel in x."""
        logs, (_, by, bx), n = values[node["inputs"][1]], node["block"], len(node["taps"])
        # Blocks stay folded until all taps are summed: [N, T, H/by, W/bx, n + 1, by·bx], as it lies in memory.
        x = x.permute(0, 2, 3, 4, 1).unflatten(-1, (n + 1, by * bx))
        differences = x.new_empty(*x.shape[:4], n, by * bx)
        for i, tap in enumerate(node["taps"]):
            value, inside = shifted(logs.tensor[:, 0], first - logs.first, x.shape[1], tap)
            differences[..., i, :] = fold([value - inside * base[:, 0]], node["block"]).permute(0, 2, 3, 4, 1)
        wide = torch.promote_types(x.dtype, torch.float32)
        d = (x[..., :n, :] * differences).sum(-2, dtype=wide) + x[..., n, :]
        return base + unfold(d.permute(0, 4, 1, 2, 3), node["block"])

    def _features(self, node: dict, values: dict, exposure: Tensor, first: int, end: int) -> Tensor:
        """The channels of a `features` node, folded, for its frames `first` … `end`."""
        bt = node["block"][0]
        first, end = first * bt, end * bt

        def frames(i: int, offset: int = 0) -> Tensor:
            name = node["inputs"][i]
            return values[name].cut(first + offset, end + offset, self.frames[name])[:, 0]

        y, e = frames(0), exposure[:, first:end]
        has_logs = len(node["inputs"]) == 3

        def channel(name: str) -> Tensor:
            if name == "measurement":
                return y
            if name == "log_irradiance":
                return frames(2) if has_logs else tone(self.inverse(y) / e)
            if name == "log_estimate":
                return tone(frames(1))
            if name == "saturated":
                return (y >= SATURATED).to(y.dtype)
            if name == "log_exposure":
                return torch.log2(e).expand_as(y)
            raise layout.GraphError(f"feature {name!r} is not known")

        channels = [channel(name) for name in node["channels"]]
        channels += [frames(2, offset) for offset in node.get("neighbours", ())]
        return fold(channels, node["block"])
