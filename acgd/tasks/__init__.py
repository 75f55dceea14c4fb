"""The tasks. After `import acgd.tasks`, `gymnasium.make("acgd/myo-key-turn-v0")` knows them.

Planning imports this package, too, and must not wait for Gymnasium: where it has not been imported yet, the names are
registered as soon as it is.
"""

import sys
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import ModuleType


class _AfterGymnasium(MetaPathFinder):
    """Registers the tasks when Gymnasium has been imported."""

    def find_spec(self, name: str, path: object, target: object = None) -> ModuleSpec | None:
        if name != "gymnasium":
            return None
        sys.meta_path.remove(self)
        spec = find_spec(name)
        if spec is not None and spec.loader is not None:
            execute = spec.loader.exec_module

            def exec_module(module: ModuleType) -> None:
                execute(module)
                _register()

            spec.loader.exec_module = exec_module
        return spec


def _register() -> None:
    from acgd.tasks import gymnasium_ids

    gymnasium_ids.register()


if "gymnasium" not in sys.modules:
    sys.meta_path.insert(0, _AfterGymnasium())
elif hasattr(sys.modules["gymnasium"], "register"):
    _register()
