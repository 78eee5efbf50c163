"""A torch module from a layer graph (weights-format/README.md). Only those frames of a node are computed that the result
depends on.
"""

from torch import Tensor, nn

from . import layout
from .operations import Call, Convolution, Frames, operation
from .response import InverseResponse


class GraphNet(nn.Module):
    """Runs a layer graph."""

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
                first, end = needed[name]
                layer = self.layers[name] if name in self.layers else None
                call = Call(
                    node, values, self.frames, exposure, self.inverse, layer, first, end,
                    toned=toned and name == output, training=self.training,
                )  # fmt: skip
                values[name] = Frames(operation(node).compute(call), first)
        return values[output].tensor
