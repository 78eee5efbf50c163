"""Where training with small batches begins: norms with fixed statistics, LDR-net as the box filter.

The statistics of a few crops differ so much from batch to batch that a net with batch norm cannot say how bright a scene is.
So norms take theirs from the first batches and keep them, which leaves scale and shift to be trained. A net like that can
start as something good, and needs a learning rate for each layer: batch norm undoes the steps that are too long.
"""

import math

import torch
from torch import Tensor

from .data import Batch
from .graph import Convolution, GraphNet
from .layout import node_map
from .objective import inverse_node
from .tone import LOG_SCALE, MU

FAN_IN = 64  # products in a sum up to which a layer's weights take the whole learning rate


def has_norms(net: GraphNet) -> bool:
    """Whether any layer has a norm."""
    return any(layer.norm is not None for layer in net.layers.values())


@torch.no_grad()
def fix_norms(net: GraphNet, batches: list[Batch]) -> None:
    """Gives the norms the statistics of these batches."""
    norms = [layer.norm for layer in net.layers.values() if layer.norm is not None]
    for norm in norms:
        norm.reset_running_stats()
        norm.momentum = None  # the mean of all batches
    net.train()
    for batch in batches:
        net(batch.measurement, batch.exposure)
    net.eval()


def prepare(net: GraphNet, batches: list[Batch]) -> None:
    """Fixes the norms; where LDR-net sees the box filter, all its videos are that to begin with."""
    way = way_of_the_estimate(net)
    if way is None:
        fix_norms(net, batches)
        return
    channel, first, up, last = way
    with torch.no_grad():
        first.weight[0] = 0.0
        first.weight[0, channel, *centre(first)] = 1.0
        up.weight[:, 0] = 0.0
        up.weight[0, 0, *centre(up)] = 1.0
        last.weight.mul_(0.05)
        fix_norms(net, batches)
        deviation = (first.norm.running_var[0] + first.norm.eps).sqrt()
        # The sigmoid of ln(e·p / x_sat) is the pixel value that exposure e gives, but for its soft end.
        last.weight[:, 0] = 0.0
        last.weight[:, 0, *centre(last)] = LOG_SCALE * deviation
        exposures = torch.tensor(inverse_node(net.graph)["exposures"], dtype=torch.float32)
        last.bias.copy_(LOG_SCALE * first.norm.running_mean[0] - math.log(MU) + (exposures / net.inverse.saturation).log())
    fix_norms(net, batches)


def centre(layer: Convolution) -> list[int]:
    """The middle of a kernel, where it takes the pixel itself."""
    return [size // 2 for size in layer.kernel]


def way_of_the_estimate(net: GraphNet) -> tuple[int, Convolution, Convolution, Convolution] | None:
    """The channel of the box estimate, and the layers that it can pass to LDR-net's videos: first, before last, last.

    None where the graph has no such way: features → first → concat → before last → last, with a sigmoid.
    """
    nodes, inverse = node_map(net.graph), inverse_node(net.graph)
    if inverse is None:
        return None
    last = nodes[inverse["inputs"][0]]
    up = nodes.get(last["inputs"][0], {"op": None})
    concat = nodes.get(up["inputs"][0]) if up["op"] == "conv_transpose3d" else None
    if last["op"] != "conv3d" or last["activation"] != "sigmoid" or concat is None or concat["op"] != "concat":
        return None
    first = nodes[concat["inputs"][0]]
    features = nodes.get(first["inputs"][0], {"op": None})
    if first["op"] != "conv3d" or not first["norm"] or features["op"] != "features":
        return None
    if features["block"] != [1, 1, 1] or "log_estimate" not in features["channels"]:
        return None
    return features["channels"].index("log_estimate"), *(net.layers[node["name"]] for node in (first, up, last))


def learning_rate_shares(net: GraphNet) -> dict[Tensor, float]:
    """The share of the learning rate for each parameter.

    Adam moves every weight by about the learning rate, so a sum of n products by n times that; weights of LDR-net's last
    layer move logarithms of irradiance, of which a hundredth counts.
    """
    inverse = inverse_node(net.graph)
    shares = {}
    for name, layer in net.layers.items():
        fine = 0.1 if inverse is not None and inverse["inputs"][0] == name else 1.0
        for parameter in layer.parameters():
            shares[parameter] = fine * (min(1.0, FAN_IN / layer.fan_in) if parameter.dim() > 1 else 0.3)
    return shares
