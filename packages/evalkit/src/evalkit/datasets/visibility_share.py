"""Ground truth seen by one share of visibility or the other."""

from __future__ import annotations

from dataclasses import replace

from evalkit.datasets.documents import GroundTruth
from evalkit.datasets.scene import SHARES, Share
from evalkit.errors import InputError


def with_share(truth: GroundTruth, share: Share | None) -> GroundTruth:
    """The same ground truth with this share as the images' `visibility`; None leaves it as it is.

    Raises:
        InputError: it is no share, or the document does not hold it.
    """
    if share is None or share == truth.share:
        return truth
    if share not in SHARES:
        raise InputError(f"visibility '{share}' is not known; use one of {', '.join(SHARES)}.")
    images = [
        replace(image, visibility=other, other_visibility=image.visibility)
        for image in truth.images
        if (other := image.other_visibility) is not None
    ]
    if truth.share is None or len(images) < len(truth.images):
        known = f"holds the {truth.share} share alone" if truth.share else "does not say which share its visibility is"
        raise InputError(
            f"{truth.source}: {known}, and {share} visibility was asked for; leave out --visibility, or write the "
            "document again with 'evalkit gt' from a source that has both, such as shards."
        )
    return replace(truth, images=images, share=share)


def holds(truth: GroundTruth, share: Share) -> bool:
    """Whether every image has this share."""
    if share == truth.share:
        return True
    return truth.share is not None and all(image.other_visibility is not None for image in truth.images)


def in_words(share: Share | None) -> str:
    """For the reader of a score."""
    return f"{share} share" if share else "share not stated"
