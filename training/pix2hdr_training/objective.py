"""What is minimised in each training stage: a loss on the net's result for a batch.

Stages: `ldr` trains LDR-net alone against R(eᵢ·p) (eq. 14–16), `hdr` the fusion behind a frozen LDR-net
(eq. 24–25), `all` everything at once on the result.
"""

from torch import Tensor, nn

from .data import Batch
from .graph import GraphNet
from .layout import node_map
from .losses import SIMPLE, PaperLoss, log_pattern_mse, medium_tone
from .tone import inverse_tone, tone

STAGES = ("all", "ldr", "hdr")
FIXED_PATTERN_WEIGHT = 0.3  # of what of the error repeats with the tile, beside the loss


def inverse_node(graph: dict) -> dict | None:
    """The `inverse_response` node, whose input are LDR-net's videos; None in a single net."""
    return next((node for node in graph["nodes"] if node["op"] == "inverse_response"), None)


def ancestors(graph: dict, name: str) -> set[str]:
    """A node's name and those of all nodes that it depends on."""
    nodes, found, open_ = node_map(graph), set(), [name]
    while open_:
        node = nodes.get(open_.pop())
        if node is None or node["name"] in found:
            continue
        found.add(node["name"])
        open_ += node["inputs"] + ([node["add"]] if node.get("add") else [])
    return found


class Objective:
    """The loss of a stage; call with the net and a batch.

    With a `tile` (rows, columns), what of the error repeats with it counts once more.
    """

    def __init__(
        self,
        net: GraphNet,
        stage: str,
        loss: str,
        paper: PaperLoss | None = None,
        tile: tuple[int, int] | None = None,
    ):
        self.stage = stage
        self.inverse_node = inverse_node(net.graph)
        if stage not in STAGES:
            raise ValueError(f"stage {stage!r} is not known")
        if stage != "all" and self.inverse_node is None:
            raise ValueError(f"stage {stage}: this graph has no inverse_response, so no LDR-net and HDR-net")
        if (loss == "paper") != (paper is not None):
            raise ValueError("the paper's loss needs its parts, the others have none")
        if tile is not None and (stage == "ldr" or paper is not None):
            raise ValueError("fixed patterns are judged by log irradiance, which this stage or loss does not use")
        self.tile = tile
        self.loss = paper if paper is not None else SIMPLE[loss]
        self.medium = None
        if paper is not None:
            # Eq. 24's reference; a net without rendered exposures is judged like mpve-1-4's.
            exposures = sorted(self.inverse_node["exposures"]) if self.inverse_node else [4.0]
            self.medium = float(exposures[len(exposures) // 2])
        self.frozen = ancestors(net.graph, self.inverse_node["name"]) if stage == "hdr" else set()

    def set_mode(self, net: GraphNet) -> None:
        """Training mode, except for a frozen LDR-net, whose norms keep their statistics."""
        net.train()
        for name, layer in net.layers.items():
            if name in self.frozen:
                layer.eval()
                layer.requires_grad_(False)

    def trained_parameters(self, net: GraphNet) -> list[nn.Parameter]:
        """The parameters that this stage optimises."""
        if self.stage == "ldr":
            wanted = ancestors(net.graph, self.inverse_node["inputs"][0])
        else:
            wanted = set(net.layers) - self.frozen
        return [p for name, layer in net.layers.items() if name in wanted for p in layer.parameters()]

    def __call__(self, net: GraphNet, batch: Batch) -> Tensor:
        """The loss of a batch."""
        if self.stage == "ldr":
            node = self.inverse_node
            videos = net(batch.measurement, batch.exposure, until=node["inputs"][0]).float()
            return sum(
                self.loss(videos[:, i], net.inverse.forward(batch.truth * float(e)))
                for i, e in enumerate(node["exposures"])
            )
        value = net(batch.measurement, batch.exposure, toned=True).float()[:, 0]
        if self.medium is None:
            truth = tone(batch.truth)
            loss = self.loss(value, truth)
            return loss if self.tile is None else loss + FIXED_PATTERN_WEIGHT * log_pattern_mse(value, truth, self.tile)
        irradiance = inverse_tone(value).clamp(min=0.0)
        return self.loss(medium_tone(irradiance, self.medium), medium_tone(batch.truth, self.medium))
