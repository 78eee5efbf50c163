"""Where LDR-net and fusion begin: the videos as the box estimate, fusion with the lowest exposure.

A net like that is as good as the box filter before its first step, and what it renders is in range.
"""

import math

import torch

from .graph import GraphNet
from .layout import node_map, shapes
from .objective import inverse_node
from .tone import LOG_SCALE, MU


@torch.no_grad()
def start_as_estimate(net: GraphNet) -> bool:
    """Lets the videos begin as the box estimate at their exposures; False where their layer does not see it.

    That layer must be a transposed convolution from folded tiles to pixels, with a sigmoid, which reads a `concat` whose
    last part is the features. The sigmoid of ln(e·p / x_sat) is the pixel value that exposure e gives, but for its soft end.
    """
    nodes, inverse = node_map(net.graph), inverse_node(net.graph)
    fuse = next((node for node in net.graph["nodes"] if node["op"] == "fuse"), None)
    if inverse is None or fuse is None:
        return False
    unknown = {"op": None, "inputs": [None]}
    node = nodes.get(inverse["inputs"][0], unknown)
    concat = nodes.get(node["inputs"][0], unknown)
    features = nodes.get(concat["inputs"][-1], unknown)
    if (node["op"], concat["op"], features["op"]) != ("conv_transpose3d", "concat", "features"):
        return False
    whole_tiles = node["kernel"] == node["stride"] == features["block"]
    if not whole_tiles or node["activation"] != "sigmoid" or "log_estimate" not in features["channels"]:
        return False
    known = shapes(net.graph, *net.granularity)
    _, by, bx = features["block"]
    of_features = known[features["name"]].c
    before, of_pixel = known[concat["name"]].c - of_features, of_features // (by * bx)
    ldr = net.layers[node["name"]]
    ldr.weight.mul_(0.01)
    for pixel in range(by * bx):
        channel = before + pixel * of_pixel + features["channels"].index("log_estimate")
        ldr.weight[channel, :, 0, pixel // bx, pixel % bx] = LOG_SCALE
    exposures = torch.tensor(inverse["exposures"], dtype=torch.float32)
    ldr.bias.copy_((exposures / net.inverse.saturation / MU).log())
    # The lowest exposure is farthest from the soft end.
    fusion = net.layers[fuse["inputs"][0]]
    fusion.weight.mul_(0.1)
    fusion.bias.copy_(3.0 - 2.5 * (exposures / exposures.min()).log2())
    return True
