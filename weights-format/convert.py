"""PyTorch checkpoint of `pix2hdr_training` → weights file.

    python weights-format/convert.py RUN/checkpoint.pt OUT.safetensors [--f16]

The averaged weights are taken. Needs PyTorch, NumPy and safetensors (training/pyproject.toml).
"""

import argparse
import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "training"))

from pix2hdr_training.export import write_weights  # noqa: E402
from pix2hdr_training.train import load_checkpoint, net_from_checkpoint  # noqa: E402


def main(arguments=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkpoint", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--f16", action="store_true", help="store F16 instead of F32")
    args = parser.parse_args(arguments)
    try:
        state = load_checkpoint(args.checkpoint)
        provenance = json.loads(state["provenance"])
        net = net_from_checkpoint(state)
        write_weights(args.out, net, response=json.loads(state["response"]), provenance=provenance, half=args.f16)
    except (OSError, ValueError, RuntimeError) as error:
        print(f"convert: {args.checkpoint}: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
