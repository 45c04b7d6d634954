"""Read-only arrays that stay so in what is pickled or copied."""

from __future__ import annotations

from typing import Any

import numpy as np

NAMES = "read-only arrays"


class ReadOnly:
    """An object whose read-only arrays are so in a pickled or copied one too; numpy itself hands back writable ones."""

    def __getstate__(self) -> dict[str, Any]:
        arrays = {name: value for name, value in vars(self).items() if isinstance(value, np.ndarray)}
        return {**vars(self), NAMES: [name for name, value in arrays.items() if not value.flags.writeable]}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update((name, value) for name, value in state.items() if name != NAMES)
        for name in state.get(NAMES, ()):
            state[name].flags.writeable = False
