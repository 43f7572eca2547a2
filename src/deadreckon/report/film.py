"""Episodes of a log of pictures as film strips: frames at regular distances, side by side, in one picture each."""

import base64
import io

import numpy as np
from PIL import Image

from deadreckon.data.dataset import Dataset
from deadreckon.report.markup import Markup, tag
from deadreckon.report.parts import figure
from deadreckon.report.text import number
from deadreckon.training.pictures import of_pictures

FRAMES = 10  # of a strip
STRIPS = ("the highest return", "the median return", "the lowest return")


def strips(log: Dataset) -> Markup | None:
    """The episodes of the highest, the median and the lowest return; None of a log without pictures."""
    if not of_pictures(log.spec):
        return None
    returns, drawn, seen = log.returns(), [], set()
    order = np.argsort(-returns, kind="stable")
    places = zip(STRIPS, (0, len(order) // 2, len(order) - 1))
    for said, place in places if len(order) > 2 else [(STRIPS[0], 0), (STRIPS[-1], len(order) - 1)]:
        episode = int(order[place])
        if episode in seen:
            continue
        seen.add(episode)
        first, length = int(log.starts[episode]), int(log.lengths[episode])
        rows = first + np.unique(np.linspace(0, length - 1, FRAMES).astype(int))
        told = f"Episode {episode + 1:,}, {said}: {number(float(returns[episode]))} in {length:,} steps"
        drawn.append(figure(_strip(np.asarray(log.observations[rows]), told), told))
    return tag("div", drawn, class_="films")


def _strip(pictures: np.ndarray, told: str) -> Markup:
    """(n, height, width, channels) side by side with a pixel between them.

    Of several frames of three colours it is the newest, else the last channel alone.
    """
    shown = pictures[..., -3:] if pictures.shape[-1] % 3 == 0 else np.repeat(pictures[..., -1:], 3, -1)
    joined = np.concatenate([np.pad(each, ((0, 0), (0, 1), (0, 0)), constant_values=255) for each in shown], 1)
    file = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(joined[:, :-1])).save(file, "PNG", optimize=True)
    code = base64.b64encode(file.getvalue()).decode()
    return tag("img", src=f"data:image/png;base64,{code}", alt=f"{told}, from left to right", class_="film")
