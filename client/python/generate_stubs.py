"""Generates `backlot/v1` (messages, stubs, type hints) from the protocol's .proto files.

The build runs it; for development, `python generate_stubs.py` writes into `src/` (needs grpcio-tools).
"""

import importlib.resources
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent


def proto_root() -> Path:
    """The folder that holds `backlot/v1/*.proto`: beside this file in a source distribution, else the repository's."""
    for root in (HERE / "proto", HERE.parent.parent / "proto"):
        if (root / "backlot" / "v1").is_dir():
            return root
    raise FileNotFoundError(f"no backlot/v1/*.proto beside {HERE} or in the repository around it")


def generate(out: Path) -> Path:
    """Writes the package `backlot/v1` under `out` and returns its folder."""
    from grpc_tools import protoc

    root = proto_root()
    files = sorted(str(path.relative_to(root)) for path in root.glob("backlot/v1/*.proto"))
    out.mkdir(parents=True, exist_ok=True)
    well_known = importlib.resources.files("grpc_tools") / "_proto"
    arguments = ["protoc", f"-I{root}", f"-I{well_known}"]
    arguments += [f"--{kind}_out={out}" for kind in ("python", "grpc_python", "pyi")]
    if protoc.main(arguments + files) != 0:
        raise RuntimeError("protoc failed; its message is above")
    package = out / "backlot" / "v1"
    (package / "__init__.py").write_text('"""Generated from backlot/v1/*.proto."""\n')
    return package


if __name__ == "__main__":
    print(generate(HERE / "src"), file=sys.stderr)
