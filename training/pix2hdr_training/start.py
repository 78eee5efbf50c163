"""Where training with small batches begins: norms with fixed statistics, LDR-net's videos as what was measured.

The statistics of a few crops differ so much from batch to batch that a net with batch norm cannot say how bright a scene is.
So norms take theirs from the first batches and keep them, which leaves scale and shift to be trained. A net like that can
start as something good, and needs a learning rate for each layer: batch norm undoes the steps that are too long.
"""

import math
from dataclasses import dataclass
from itertools import product

import torch
from torch import Tensor

from .data import Batch
from .graph import Convolution, GraphNet
from .layout import node_map
from .objective import inverse_node
from .tone import LOG_SCALE, MU

FAN_IN = 64  # products in a sum up to which a layer's weights take the whole learning rate
FINE = 0.1  # share of it for layers that the estimate passes: they move logarithms of irradiance, of which a hundredth counts


def has_norms(net: GraphNet) -> bool:
    """Whether any layer has a norm."""
    return any(layer.norm is not None for layer in net.layers.values())


@dataclass
class Way:
    """How what was measured gets to LDR-net's videos: features → first → concat → up → last, with a sigmoid, then fusion."""

    features: dict
    exposures: list[float]
    first: Convolution
    up: Convolution
    last: Convolution
    fusion: Convolution

    def beginnings(self) -> list[tuple[int, int, int] | None]:
        """What each video begins as: the box estimate (None), or the log irradiance at an offset (t, y, x).

        The last videos are those of the 3×3 pixels around and of the neighbours in time, if there are that many and more.
        """
        taps = [(0, dy, dx) for dy, dx in product((-1, 0, 1), repeat=2)]
        taps += [(dt, 0, 0) for dt in self.features.get("neighbours", ())]
        estimates = len(self.exposures) - len(taps)
        return [None] * estimates + taps if estimates > 0 else [None] * len(self.exposures)

    def source(self, tap: tuple[int, int, int] | None, pixel: tuple[int, int]) -> tuple[int, int, int]:
        """Input channel of the first layer, and row and column from its kernel's middle, that a tile's pixel begins as."""
        (_, by, bx), kinds = self.features["block"], self.features["channels"]
        neighbours = self.features.get("neighbours", [])
        dt, dy, dx = tap or (0, 0, 0)
        if tap is None:
            channel = kinds.index("log_estimate")
        else:
            channel = len(kinds) + neighbours.index(dt) if dt else kinds.index("log_irradiance")
        (ty, y), (tx, x) = divmod(pixel[0] + dy, by), divmod(pixel[1] + dx, bx)
        return (y * bx + x) * (len(kinds) + len(neighbours)) + channel, ty, tx


def way_of_the_estimate(net: GraphNet) -> Way | None:
    """The way in this net; None where the graph has none, or too few channels for it."""
    nodes, inverse = node_map(net.graph), inverse_node(net.graph)
    if inverse is None:
        return None
    last = nodes[inverse["inputs"][0]]
    up = nodes.get(last["inputs"][0], {"op": None})
    concat = nodes.get(up["inputs"][0]) if up["op"] == "conv_transpose3d" else None
    if concat is None or concat["op"] != "concat" or last["activation"] != "sigmoid":
        return None
    first = nodes[concat["inputs"][0]]
    features = nodes.get(first["inputs"][0], {"op": None})
    if first["op"] != "conv3d" or not first["norm"] or first["stride"] != [1, 1, 1] or features["op"] != "features":
        return None
    whole_tiles = last["op"] == "conv_transpose3d" and last["kernel"] == last["stride"] == features["block"]
    if not whole_tiles or not {"log_estimate", "log_irradiance"} <= set(features["channels"]):
        return None
    fusion = next(node["inputs"][0] for node in net.graph["nodes"] if node["op"] == "fuse")
    layers = (net.layers[name] for name in (first["name"], up["name"], last["name"], fusion))
    return Way(features, inverse["exposures"], *layers)


@torch.no_grad()
def fix_norms(net: GraphNet, batches: list[Batch], kept: Convolution | None = None) -> None:
    """Gives the norms the statistics of these batches, except for the one of `kept`."""
    net.train()
    for layer in net.layers.values():
        if layer is kept:
            layer.eval()
        elif layer.norm is not None:
            layer.norm.reset_running_stats()
            layer.norm.momentum = None  # the mean of all batches
    for batch in batches:
        net(batch.measurement, batch.exposure)
    net.eval()


@torch.no_grad()
def prepare(net: GraphNet, batches: list[Batch]) -> None:
    """Fixes the norms; LDR-net's videos become what was measured, where it has a way for that."""
    way = way_of_the_estimate(net)
    if way is None:
        fix_norms(net, batches)
        return
    first, up, last = way.first, way.up, way.last
    _, by, bx = way.features["block"]
    beginnings = way.beginnings()
    sources = {
        (video, pixel): way.source(tap, pixel)
        for video, tap in enumerate(beginnings)
        for pixel in product(range(by), range(bx))
    }
    channels = {source: channel for channel, source in enumerate(dict.fromkeys(sources.values()))}
    count = len(channels)
    for layer in (first, up):
        if count > layer.node["out_channels"]:
            raise ValueError(f"{layer.node['name']}: {count} channels are needed to start as what was measured")

    t, y, x = centre(first)
    first.weight[:count] = 0.0
    up.weight[:, :count] = 0.0
    for (source, ty, tx), channel in channels.items():
        first.weight[channel, source, t, y + ty, x + tx] = 1.0
        up.weight[channel, channel, *centre(up)] = 1.0
    last.weight.mul_(0.05)
    last.weight[:count] = 0.0
    fix_norms(net, batches)
    # One scale and shift for all that is passed on, because a video has one bias for all pixels of a tile.
    norm = first.norm
    for statistic in (norm.running_mean, norm.running_var):
        statistic[:count] = statistic[:count].mean()
    mean, deviation = norm.running_mean[0], (norm.running_var[0] + norm.eps).sqrt()
    # The sigmoid of ln(e·p / x_sat) is the pixel value that exposure e gives, but for its soft end.
    for (video, (py, px)), source in sources.items():
        last.weight[channels[source], video, 0, py, px] = LOG_SCALE * deviation
    exposures = torch.tensor(way.exposures, dtype=torch.float32)
    last.bias.copy_(LOG_SCALE * mean - math.log(MU) + (exposures / net.inverse.saturation).log())
    # Fusion begins with the box estimate at the lowest exposure, which is farthest from the soft end.
    stops = (exposures / exposures.min()).log2()
    is_estimate = torch.tensor([tap is None for tap in beginnings])
    way.fusion.bias.copy_(torch.where(is_estimate, 3.0 - 2.5 * stops, -2.0))
    way.fusion.weight.mul_(0.1)
    fix_norms(net, batches, kept=first)


def centre(layer: Convolution) -> list[int]:
    """The middle of a kernel, where it takes the pixel itself."""
    return [size // 2 for size in layer.kernel]


def learning_rate_shares(net: GraphNet) -> dict[Tensor, float]:
    """The share of the learning rate for each parameter.

    Adam moves every weight by about the learning rate, so a sum of n products by n times that.
    """
    inverse, way = inverse_node(net.graph), way_of_the_estimate(net)
    fine = {net.layers[inverse["inputs"][0]]} if inverse else set()
    if way is not None:
        fine |= {way.up, way.fusion}
    shares = {}
    for layer in net.layers.values():
        whole = FINE if layer in fine else 1.0
        for parameter in layer.parameters():
            shares[parameter] = whole * (min(1.0, FAN_IN / layer.fan_in) if parameter.dim() > 1 else 0.3)
    return shares


def centred_weights(net: GraphNet) -> list[Tensor]:
    """Weights whose filters keep their means in training.

    Logarithms are all near 0.8, so a step that moves all weights of a filter the same way would drown what it passes on.
    """
    way = way_of_the_estimate(net)
    return [] if way is None else [way.first.weight]
