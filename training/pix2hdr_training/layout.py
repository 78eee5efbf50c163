"""Shapes, granularity and cost of a layer graph (weights-format/README.md), without any tensors."""

from math import lcm, prod

from .operations import GraphError, Shape, operation

CONVOLUTIONS = ("conv3d", "conv_transpose3d")


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
        y, x = (operation(node).span(node, pixels, axis) for axis, pixels in enumerate(factors[source], 1))
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
    try:
        shape = operation(node).shape(node, inputs)
        if node.get("add") and known[node["add"]] != shape:
            raise GraphError("`add` has another shape")
    except GraphError as error:
        problem = str(error)
        raise GraphError(problem if problem.startswith("node ") else f"node {node['name']!r}: {problem}") from None
    return shape


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
        for number, name in enumerate(node["inputs"]):
            need(name, *operation(node).reads(node, number, first, end))
        if node.get("add"):
            need(node["add"], first, end)
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
