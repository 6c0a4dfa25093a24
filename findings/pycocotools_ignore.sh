#!/usr/bin/env bash
# pycocotools passes over `ignore` in annotations, which BOP's scene_gt_coco.json marks hidden instances with: they
# count as missed.
#
# pycocotools 2.0.11, numpy 2.2.6, Python 3.10 to 3.13. COCOeval prepares `ignore` from the annotation and in the next
# line overwrites it by `iscrowd`. The image below has one instance in view, found exactly, and one that is wholly hidden,
# which no method can find.
#
# Seen:  hidden instance with "ignore": true    AP 0.505, as without the mark
#        hidden instance with "iscrowd": 1      AP 1.000
#
# Why it matters: in a bin most instances lie below others. The files of the BOP challenge (and of BlenderProc and
# bop_toolkit, which write them) have "ignore": true for those less than a tenth visible, and "iscrowd": 0; scored by
# pycocotools as it is installed, detections on them have an AP far below what the challenge's own copy computes.
# Exits 0 while pycocotools behaves so, non-zero once that changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "pycocotools==2.0.11" "numpy==2.2.6"
"$folder/venv/bin/python" - <<'PYTHON' || { echo "The behavior has changed."; exit 1; }
import contextlib
import io
import sys

from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval


def average_precision(**hidden):
    """AP of one detection, which is right, where a second instance is annotated with `hidden`."""
    common = {"image_id": 1, "category_id": 1, "area": 400, "iscrowd": 0, "ignore": False}
    truth, found = COCO(), [{"image_id": 1, "category_id": 1, "bbox": [0, 0, 20, 20], "score": 0.9}]
    truth.dataset = {
        "images": [{"id": 1, "width": 100, "height": 100}],
        "categories": [{"id": 1, "name": "bracket"}],
        "annotations": [
            {**common, "id": 1, "bbox": [0, 0, 20, 20]},
            {**common, "id": 2, "bbox": [50, 50, 20, 20], **hidden},
        ],
    }
    with contextlib.redirect_stdout(io.StringIO()):
        truth.createIndex()
        evaluation = COCOeval(truth, truth.loadRes(found), "bbox")
        evaluation.evaluate()
        evaluation.accumulate()
        evaluation.summarize()
    return evaluation.stats[0]


plain, ignored, crowd = average_precision(), average_precision(ignore=True), average_precision(iscrowd=1)
print(f"without a mark {plain:.3f}, ignore {ignored:.3f}, iscrowd {crowd:.3f}")
sys.exit(0 if ignored == plain < 0.51 and crowd > 0.99 else 1)
PYTHON
