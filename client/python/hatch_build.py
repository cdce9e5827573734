"""Build hook: puts the generated `backlot/v1` into the wheel, or into `src/` for an editable install."""

import sys
import tempfile
from pathlib import Path

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class GenerateStubs(BuildHookInterface):
    def initialize(self, version, build_data):
        if self.target_name != "wheel":
            return
        sys.path.insert(0, self.root)
        from generate_stubs import generate

        if version == "editable":
            generate(Path(self.root) / "src")
            return
        self._generated = tempfile.TemporaryDirectory(prefix="backlot-stubs-")
        package = generate(Path(self._generated.name))
        build_data["force_include"][str(package)] = "backlot/v1"
