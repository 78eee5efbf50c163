"""A trained net's weights in another net that has its layers: wider, with others behind them, or for another pattern.

Widening follows Net2Net (Chen, Goodfellow, Shlens, 2016): each new channel repeats an old one, and what reads them
shares the old weight among the repeats, unevenly, so that training can tell them apart. The wider net computes what the
narrower one did.
"""

import torch
from torch import Tensor

from .graph import GraphNet
from .layout import CONVOLUTIONS, node_map, shapes

OPERATIONS = ("blend", "fuse", "inverse_response")  # what gives the channels of a layer their meaning


def widened(state: dict[str, Tensor], net: GraphNet, seed: int = 0) -> dict[str, Tensor]:
    """A state of `net` from the `state` of a net whose layers it has, with the same names and kernels.

    Layers that the other net lacks are as they are in `net`. A layer that now reads a `concat` of what it read before and of
    layers that the other net lacks starts with zeros for these. ValueError where `net` lacks a layer, or has it with another
    kernel, with fewer channels, or with more where they mean something: behind features, an operation or another `concat`,
    or before an operation.
    """
    target = net.state_dict()
    lacking = sorted(set(state) - set(target))
    if lacking:
        raise ValueError(f"the nets' layers differ: {lacking[0]}")
    known, nodes = shapes(net.graph, *net.granularity), node_map(net.graph)
    operands = {source for node in nodes.values() if node["op"] in OPERATIONS for source in node["inputs"]}
    random = torch.Generator().manual_seed(seed)
    result = dict(target)
    for name, old in state.items():
        new = target[name]
        layer = net.layers[name.split(".")[1]]
        source = nodes[layer.node["inputs"][0]]
        if old.dim() != new.dim() or old.shape[2:] != new.shape[2:] or any(n < o for n, o in zip(new.shape, old.shape)):
            raise ValueError(f"{name}: {tuple(old.shape)} cannot become {tuple(new.shape)}")
        value = old
        for axis in range(min(old.dim(), 2)):
            count, wide = old.shape[axis], new.shape[axis]
            if wide == count:
                continue
            is_input = old.dim() > 1 and axis == (0 if layer.transposed else 1)
            if is_input and source["op"] == "concat":
                first, *others = source["inputs"]
                if known[first].c != count or any(f"layers.{other}.weight" in state for other in others):
                    raise ValueError(f"{name}: what it read is not the first part of {source['name']!r} alone")
                zeros = value.new_zeros([wide - count if a == axis else n for a, n in enumerate(value.shape)])
                value = torch.cat([value, zeros], axis)
                continue
            has_meaning = source["op"] not in CONVOLUTIONS if is_input else layer.node["name"] in operands
            if has_meaning:
                raise ValueError(f"{name}: {count} channels cannot become {wide}: they are no features that could be repeated")
            origin = torch.arange(wide) % count
            value = value.index_select(axis, origin)
            if is_input:
                value = value * _shares(value, axis, origin, count, random)
        result[name] = value.clone()
    return result


def _shares(weight: Tensor, axis: int, origin: Tensor, count: int, random: torch.Generator) -> Tensor:
    """For each output and input channel the share of the old weight; those of one origin sum to 1."""
    share = 0.5 + torch.rand((*weight.shape[:2], *[1] * (weight.dim() - 2)), generator=random)
    total = share.new_zeros([count if a == axis else n for a, n in enumerate(share.shape)])
    return share / total.index_add_(axis, origin, share).index_select(axis, origin)
