"""A trained net's weights in another net of the same layers, wider or for another pattern.

Widening follows Net2Net (Chen, Goodfellow, Shlens, 2016): each new channel repeats an old one, and what reads them
shares the old weight among the repeats, unevenly, so that training can tell them apart. The wider net computes what the
narrower one did.
"""

import torch
from torch import Tensor

from .graph import GraphNet


def widened(state: dict[str, Tensor], net: GraphNet, seed: int = 0) -> dict[str, Tensor]:
    """A state of `net` from the `state` of a net whose layers have the same names and kernels.

    ValueError where a layer is missing, has another kernel or fewer channels, or where a wider layer reads a `concat`.
    """
    target = net.state_dict()
    different = sorted(set(state) ^ set(target))
    if different:
        raise ValueError(f"the nets' layers differ: {different[0]}")
    concats = {node["name"] for node in net.graph["nodes"] if node["op"] == "concat"}
    random = torch.Generator().manual_seed(seed)
    result = {}
    for name, new in target.items():
        old = state[name]
        layer = net.layers[name.split(".")[1]]
        if old.dim() != new.dim() or old.shape[2:] != new.shape[2:] or any(n < o for n, o in zip(new.shape, old.shape)):
            raise ValueError(f"{name}: {tuple(old.shape)} cannot become {tuple(new.shape)}")
        inputs = 0 if layer.transposed else 1  # the axis of a weight's input channels
        value = old
        for axis in range(min(old.dim(), 2)):
            count, wide = old.shape[axis], new.shape[axis]
            if wide == count:
                continue
            origin = torch.arange(wide) % count
            value = value.index_select(axis, origin)
            if axis == inputs and old.dim() > 1:
                if layer.node["inputs"][0] in concats:
                    raise ValueError(f"{name}: a layer that reads a concat cannot be widened")
                value = value * _shares(value, axis, origin, count, random)
        result[name] = value.clone()
    return result


def _shares(weight: Tensor, axis: int, origin: Tensor, count: int, random: torch.Generator) -> Tensor:
    """For each output and input channel the share of the old weight; those of one origin sum to 1."""
    share = 0.5 + torch.rand((*weight.shape[:2], *[1] * (weight.dim() - 2)), generator=random)
    total = share.new_zeros([count if a == axis else n for a, n in enumerate(share.shape)])
    return share / total.index_add_(axis, origin, share).index_select(axis, origin)
