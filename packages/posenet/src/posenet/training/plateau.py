"""When a run has nothing more to learn, and when it learns nothing at all: both can be seen long before its end."""

from __future__ import annotations

from collections.abc import Sequence

Rows = Sequence[dict[str, float]]

# In the first half, at the peak of the learning rate, AP jumps about near zero, whatever comes of it.
FIRST_JUDGED = 0.5
LEAST_RISE = 0.005
PERFECT = 0.995
# Every network that came to something found most boxes within 3,000 images, and was off zero at two thirds of its run.
BOXES_BY, LEAST_BOX_RECALL = 5000, 0.2
AP_BY, LEAST_AP, AP_IMAGES = 0.66, 0.02, 8000


def no_longer_rises(validations: Rows) -> bool:
    """Whether two validations in a row, late enough to count, brought nothing over the best before; or all is right."""
    judged = [row["ap"] for row in validations if row.get("progress", 0.0) >= FIRST_JUDGED]
    if judged and judged[-1] >= PERFECT:
        return True
    return len(judged) >= 3 and max(judged[-2:]) < max(judged[:-2]) + LEAST_RISE


def learns_nothing(validation: dict[str, float]) -> str | None:
    """What is wrong, as the beginning of a sentence, where a validation shows that a run comes to nothing."""
    images, ap, recall = int(validation["images"]), validation["ap"], validation["box_recall"]
    if images >= BOXES_BY and recall < LEAST_BOX_RECALL:
        return f"after {images} images it finds {recall:.0%} of the held-out instances, where most are usual"
    if images >= AP_IMAGES and validation["progress"] >= AP_BY and ap < LEAST_AP:
        return f"after {images} images AP is {ap:.3f}, though {recall:.0%} of the held-out instances are found"
    return None
