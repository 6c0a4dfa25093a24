"""Poses from what `posenet export` wrote, in plain NumPy: ONNX Runtime runs the graphs, this file does the rest.

    posenet export data/models/bunny-stereo.pt -o bunny.onnx
    python examples/onnx_decoder.py bunny.onnx depth.npy camera.json

depth.npy holds meters, 0 where nothing returned; camera.json {"width", "height", "fx", "fy", "cx", "cy"}. docs/onnx.md
explains the rules, which bunny.json names. The poses are those of `posenet predict --precision float32`.
"""

import json
import math
import sys
from pathlib import Path

import numpy as np
import onnxruntime


class Decoder:
    def __init__(self, path):
        path = Path(path)
        self.rules = json.loads(path.with_suffix(".json").read_text())
        assert self.rules["format"] == "binpose-onnx/2", "written by another version of posenet"
        files = [path, *(path.with_name(f"{path.stem}-{part}.onnx") for part in ("regions", "scores"))]
        self.trunk, self.regions, self.scores = (onnxruntime.InferenceSession(str(file)) for file in files)

    def __call__(self, depth, camera):
        """cam_from_obj (n, 4, 4) in meters and scores (n,), best first, of a depth image (height, width)."""
        depth, intrinsics = self.on_trained_grid(np.asarray(depth, np.float32), camera)
        image = {"depth": depth[None], "intrinsics": np.array([intrinsics], np.float32)}
        image |= run(self.trunk, image)
        detections = self.rules["detections"]
        most = max(detections["least"], math.ceil(detections["per_pixel"] * depth.size))
        score, box = image["score"][0], image["box"][0]
        rows = suppressed(score, box, most, detections["before_regions"])
        if len(rows) == 0:
            return np.zeros((0, 4, 4)), np.zeros(0)
        found = run(self.regions, image | {"box": box[rows], "score": score[rows]})
        if detections["after_regions"] is not None:
            rows = suppressed(found["refined_score"], found["refined_box"], most, detections["after_regions"])
            found = {name: value[rows] for name, value in found.items()}
        kept = found["kept"] & (found["reference_depth"] > 0)[:, None]
        region = np.nonzero(kept)[0]
        if len(region) == 0:
            return np.zeros((0, 4, 4)), np.zeros(0)
        claims = {name: found[name][kept] for name in ("rotation", "center", "relative", "confidence")}
        score = run(self.scores, image | claims | {"region": region})["final_score"]
        cam_from_canonical = np.tile(np.eye(4), (len(region), 1, 1))
        cam_from_canonical[:, :3, :3], cam_from_canonical[:, :3, 3] = claims["rotation"], claims["center"]
        order = np.argsort(-score, kind="stable")
        return (cam_from_canonical @ np.linalg.inv(self.rules["obj_from_canonical"]))[order], score[order]

    def on_trained_grid(self, depth, camera):
        """The image in which the object has its trained size, in whole cells, and its fx, fy, cx, cy."""
        rule, (height, width) = self.rules["image"], depth.shape
        fx, fy, cx, cy = (camera[name] for name in ("fx", "fy", "cx", "cy"))
        zoom = self.zoom(depth, rule["zoom"]) if rule["zoom"] is not None else 1.0
        scale_x, scale_y = zoom * rule["camera"]["fx"] / fx, zoom * rule["camera"]["fy"] / fy
        if max(abs(scale_x - 1), abs(scale_y - 1)) >= rule["focal_tolerance"]:
            columns, fx, cx = nearest(width, max(1, round(width * scale_x)), fx, cx)
            rows, fy, cy = nearest(height, max(1, round(height * scale_y)), fy, cy)
            depth = depth[rows[:, None], columns]
        step = rule["multiple_of"]
        return np.pad(depth, [(0, -side % step) for side in depth.shape]), (fx, fy, cx, cy)

    @staticmethod
    def zoom(depth, rule):
        """How much larger a scene must become that is farther off (or nearer) than those trained on."""
        seen = depth[:: rule["every_pixel"], :: rule["every_pixel"]]
        seen = seen[seen > 0]
        plausible = seen[(seen > rule["plausible"][0]) & (seen < rule["plausible"][1])]
        if len(plausible) > rule["least_plausible"] * len(seen):
            seen = plausible
        if len(seen) == 0:
            return 1.0
        median = np.sort(seen)[(len(seen) - 1) // 2]
        if rule["unchanged"][0] <= median <= rule["unchanged"][1]:
            return 1.0
        steps = rule["steps_an_octave"]
        return 2.0 ** (round(steps * math.log2(median / rule["trained"])) / steps)


def nearest(of, count, focal, principal):
    """Which of `of` pixels in a row each of `count` takes; the focal length and principal point of the new row."""
    taken = np.minimum(((np.arange(count) + 0.5) * (of / count)).astype(int), of - 1)
    return taken, focal * count / of, np.mean(np.arange(count) - (taken - principal) * (count / of))


def suppressed(score, box, most, rule):
    """The boxes to keep, best first: sure and wide enough, and none that overlaps a better one by too much."""
    order = np.argsort(-score, kind="stable")
    if rule["candidates"] is not None:
        order = order[: round(rule["candidates"] * most)]
    sides = box[:, 2:] - box[:, :2]
    order = order[(score[order] >= rule["least_score"]) & (sides[order] >= rule["least_side"]).all(1)]
    kept = []
    while len(order) and len(kept) < round(rule["kept"] * most):
        best, order = order[0], order[1:]
        kept.append(best)
        low = np.maximum(box[best, :2], box[order, :2])
        shared = np.clip(np.minimum(box[best, 2:], box[order, 2:]) - low, 0, None).prod(1)
        union = sides[best].prod() + sides[order].prod(1) - shared
        order = order[~(shared > rule["drop_iou_above"] * union)]
    return np.array(kept, int)


def run(session, values):
    """The graph's outputs by name; of `values` it takes its inputs."""
    wanted = {one.name: values[one.name] for one in session.get_inputs()}
    names = [one.name for one in session.get_outputs()]
    return dict(zip(names, session.run(names, wanted), strict=True))


if __name__ == "__main__":
    poses, scores = Decoder(sys.argv[1])(np.load(sys.argv[2]), json.loads(Path(sys.argv[3]).read_text()))
    print(json.dumps([{"score": float(s), "cam_from_obj": p.tolist()} for s, p in zip(scores, poses, strict=True)]))
