"""Shapes, granularity and cost of a layer graph (weights-format/README.md), without any tensors."""

from dataclasses import dataclass
from math import lcm, prod

FEATURE_CHANNELS = ("measurement", "log_irradiance", "log_estimate", "saturated", "log_exposure")
CONVOLUTIONS = ("conv3d", "conv_transpose3d")


class GraphError(ValueError):
    """A layer graph that breaks a rule of the weights format; the message names the node."""


@dataclass(frozen=True)
class Shape:
    """Frames, height, width and channels of a node's tensor."""

    t: int
    y: int
    x: int
    c: int


def node_map(graph: dict) -> dict:
    """Nodes by name."""
    return {node["name"]: node for node in graph["nodes"]}


def granularity(graph: dict) -> tuple[int, int]:
    """(rows, columns) of which H and W must be multiples."""
    factors = {"measurement": (1, 1)}
    gy, gx = 1, 1
    for node in graph["nodes"]:
        source = node["inputs"][0]
        if source not in factors:
            raise GraphError(f"node {node['name']!r}: input {source!r} does not stand before it")
        y, x = factors[source]
        if node["op"] == "features":
            y, x = y * node["block"][1], x * node["block"][2]
        elif node["op"] == "conv3d":
            y, x = y * node["stride"][1], x * node["stride"][2]
        elif node["op"] == "conv_transpose3d":
            y, x = max(1, y // node["stride"][1]), max(1, x // node["stride"][2])
        elif node["op"] == "blend":
            y, x = max(1, y // node["block"][1]), max(1, x // node["block"][2])
        factors[node["name"]] = (y, x)
        gy, gx = lcm(gy, y), lcm(gx, x)
    return gy, gx


def shapes(graph: dict, height: int, width: int) -> dict[str, Shape]:
    """Shape of every node for one window of height × width pixels; checks every rule on shapes."""
    rows, columns = granularity(graph)
    if height % rows or width % columns or height < 1 or width < 1:
        raise GraphError(f"{height}×{width} pixels: not a multiple of the granularity {rows}×{columns}")
    known = {"measurement": Shape(graph["window"]["frames"], height, width, 1)}
    for node in graph["nodes"]:
        name = node["name"]
        if name in known:
            raise GraphError(f"node {name!r}: the name is taken")
        for other in [*node["inputs"], *([node["add"]] if node.get("add") else [])]:
            if other not in known:
                raise GraphError(f"node {name!r}: input {other!r} does not stand before it")
        known[name] = _shape(node, [known[i] for i in node["inputs"]], known)
    if graph["output"] not in known:
        raise GraphError(f"output {graph['output']!r}: no such node")
    window = graph["window"]
    if known[graph["output"]].t not in (window["frames"], window["hop"]):
        raise GraphError("output: has neither `frames` nor `hop` frames")
    if window["lead"] + window["hop"] > window["frames"]:
        raise GraphError("window: the result reaches beyond the frames")
    return known


def _shape(node: dict, inputs: list[Shape], known: dict[str, Shape]) -> Shape:
    name, op = node["name"], node["op"]

    def need(condition: bool, message: str) -> None:
        if not condition:
            raise GraphError(f"node {name!r}: {message}")

    first = inputs[0]
    if op in ("box_estimate", "log_irradiance"):
        need(node["inputs"] == ["measurement"], "takes `measurement`")
        return first
    if op == "features":
        bt, by, bx = node["block"]
        need(len(inputs) in (2, 3) and node["inputs"][0] == "measurement", "takes `measurement` and an estimate")
        need(all(i == first for i in inputs), "its inputs differ in shape")
        need(len(inputs) == 3 or not node.get("neighbours"), "neighbours are those of a log_irradiance")
        need(first.t % bt == 0 and first.y % by == 0 and first.x % bx == 0, "the block does not divide the input")
        channels = len(node["channels"]) + len(node.get("neighbours", ()))
        return Shape(first.t // bt, first.y // by, first.x // bx, channels * bt * by * bx)
    if op in CONVOLUTIONS:
        out = []
        for n, k, s in zip((first.t, first.y, first.x), node["kernel"], node["stride"], strict=True):
            if op == "conv3d":
                need(k % 2 == 1, "the kernel must be odd")
                out.append(-(-n // s))
            else:
                need(k >= s and (k - s) % 2 == 0, "kernel − stride must be even")
                out.append(n * s)
        shape = Shape(*out, node["out_channels"])
        if node.get("add"):
            need(known[node["add"]] == shape, "`add` has another shape")
        return shape
    if op == "concat":
        need(all((i.t, i.y, i.x) == (first.t, first.y, first.x) for i in inputs), "inputs differ in size")
        need(all(i.c % 4 == 0 for i in inputs[:-1]), "all inputs but the last need a multiple of 4 channels")
        return Shape(first.t, first.y, first.x, sum(i.c for i in inputs))
    if op == "inverse_response":
        need(len(node["exposures"]) == first.c, "one exposure for each channel")
        return Shape(first.t, first.y, first.x, 2 * first.c)
    if op == "fuse":
        need(len(inputs) == 2 and inputs[1] == Shape(first.t, first.y, first.x, 2 * first.c), "takes n weights and 2n channels")
        return Shape(first.t, first.y, first.x, 1)
    if op == "blend":
        bt, by, bx = node["block"]
        need(bt == 1 and first.c == by * bx * (len(node["taps"]) + 1), "the block does not fit the channels")
        shape = Shape(first.t, first.y * by, first.x * bx, 1)
        need(inputs[1:] == [shape, shape], "log irradiance and estimate do not fit the weights")
        return shape
    raise GraphError(f"node {name!r}: operation {op!r} is not known")


def needed_frames(graph: dict, output: str | None = None) -> dict[str, tuple[int, int]]:
    """Frames [first, end) of every node's tensor that the result's `hop` frames depend on.

    `output` stands in for the graph's output. Nodes that it does not depend on are left out.
    """
    known = shapes(graph, *granularity(graph))
    window, output = graph["window"], output or graph["output"]
    frames = known[output].t
    needed = {output: (window["lead"], window["lead"] + window["hop"]) if frames == window["frames"] else (0, frames)}

    def need(name: str, first: int, end: int) -> None:
        first, end = max(first, 0), min(end, known[name].t)
        before = needed.get(name, (first, end))
        needed[name] = min(first, before[0]), max(end, before[1])

    for node in reversed(graph["nodes"]):
        if node["name"] not in needed:
            continue
        first, end = needed[node["name"]]
        source, op = node["inputs"][0], node["op"]
        if op in CONVOLUTIONS:
            k, s = node["kernel"][0], node["stride"][0]
            if op == "conv3d":
                need(source, first * s - k // 2, (end - 1) * s - k // 2 + k)
            else:
                padding = (k - s) // 2
                need(source, -((k - 1 - padding - first) // s), (end - 1 + padding) // s + 1)
            if node.get("add"):
                need(node["add"], first, end)
        elif op == "features":
            bt = node["block"][0]
            need(node["inputs"][1], first * bt, end * bt)
            need(source, first * bt, end * bt)
            if len(node["inputs"]) == 3:
                offsets = [0, *node.get("neighbours", ())]
                need(node["inputs"][2], first * bt + min(offsets), end * bt + max(offsets))
        elif op == "blend":
            offsets = [tap[0] for tap in node["taps"]]
            need(source, first, end)
            need(node["inputs"][1], first + min([0, *offsets]), end + max([0, *offsets]))
            need(node["inputs"][2], first, end)
        else:
            for name in node["inputs"]:
                need(name, first, end)
    return needed


def tensor_shapes(graph: dict) -> dict[str, tuple[int, ...]]:
    """Name and shape of every tensor that a weights file of this graph holds."""
    rows, columns = granularity(graph)
    known = shapes(graph, rows, columns)
    tensors: dict[str, tuple[int, ...]] = {}
    for node in graph["nodes"]:
        if node["op"] not in CONVOLUTIONS:
            continue
        inside, outside = known[node["inputs"][0]].c, node["out_channels"]
        ends = (outside, inside) if node["op"] == "conv3d" else (inside, outside)
        tensors[node["name"] + ".weight"] = (*ends, *node["kernel"])
        tensors[node["name"] + ".bias"] = (outside,)
        if node.get("norm"):
            tensors[node["name"] + ".scale"] = (outside,)
            tensors[node["name"] + ".shift"] = (outside,)
    return tensors


def gflop_per_frame(graph: dict, height: int = 128, width: int = 128) -> float:
    """2 × multiply-adds of all convolutions for one result frame (a window's work over `hop`), in 10⁹.

    Frames that no result depends on are not computed and don't count.
    """
    known, needed = shapes(graph, height, width), needed_frames(graph)
    macs = 0
    for node in graph["nodes"]:
        if node["op"] not in CONVOLUTIONS or node["name"] not in needed:
            continue
        inside = known[node["inputs"][0]]
        # A transposed convolution spreads each *input* position over its kernel.
        name = node["name"] if node["op"] == "conv3d" else node["inputs"][0]
        at, (first, end) = known[name], needed[name]
        macs += (end - first) * at.y * at.x * prod(node["kernel"]) * inside.c * node["out_channels"]
    return 2e-9 * macs / graph["window"]["hop"]


def parameter_count(graph: dict) -> int:
    """Number of values in a weights file of this graph."""
    return sum(prod(shape) for shape in tensor_shapes(graph).values())
