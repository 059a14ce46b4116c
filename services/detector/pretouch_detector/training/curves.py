"""The curves of a training, as a picture."""

from __future__ import annotations

import json
from pathlib import Path

from pretouch.errors import NotFound

_PREFIX = "validation "


def draw_curves(run: Path) -> Path:
    """A panel for each term of the loss, on both sides, from `run/log.json`; the picture's path.

    Raises:
        NotFound: there is no log.
    """
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    path = run / "log.json"
    if not path.is_file():
        raise NotFound(f"{run} holds no log.json.", "Give the folder of a training.")
    log = json.loads(path.read_text())
    names = [name for name in log[0] if not name.startswith(_PREFIX)]
    figure, axes = plt.subplots(1, len(names), figsize=(3.4 * len(names), 3), layout="constrained", squeeze=False)
    epochs = range(1, len(log) + 1)
    for axis, name in zip(axes[0], names, strict=True):
        axis.plot(epochs, [entry[name] for entry in log], label="train")
        if _PREFIX + name in log[0]:
            axis.plot(epochs, [entry[_PREFIX + name] for entry in log], label="validation")
        axis.set(title=name, xlabel="epoch")
        axis.legend(frameon=False)
    picture = run / "curves.png"
    figure.savefig(picture, dpi=90)
    plt.close(figure)
    return picture
