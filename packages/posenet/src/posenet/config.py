"""What can be chosen, and the three presets. Every choice is an option of one network, not a second network.

`paper` follows Sock et al. (BMVC 2018) to the letter where it is explicit; `small` trains usefully on two CPU cores in
minutes and differs where a difference was measured to gain; `debug` is for tests and takes seconds.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import Any, Literal

from evalkit.errors import InputError
from evalkit.typed import typed

TASKS = ("offset", "depth", "rotation")
OPTIMIZERS = ("adam", "adamw", "muon")
SCHEDULES = ("trapezoid", "one-cycle", "cosine", "constant")
PRECISIONS = ("auto", "float32", "bfloat16")  # of layers that predict; auto: bfloat16 where the hardware has it


@dataclass(frozen=True)
class NetworkConfig:
    """The architecture: trunk, detector, regions, pose heads, registration."""

    backbone: Literal["vgg16", "vgg_small", "vgg_debug"] = "vgg_small"
    # Third and second input channel: holes and slant beside depth, or two components of the surface normal.
    input: Literal["depth-holes", "depth-normals"] = "depth-normals"
    detector: Literal["rpn", "heatmap"] = "heatmap"
    # A region is the detected box, or a window of fixed metric side (times the diameter) at the box's median depth.
    roi: Literal["box", "metric"] = "metric"
    roi_scale: float = 1.1
    roi_size: int = 8
    crop_size: int = 64  # a raw crop of relative depth and normals beside the trunk's features; 0: none
    crop_widths: tuple[int, ...] = (16, 32, 64, 128)  # channels of the crop's branch, at each halving
    crop_layers: int = 2  # convolutions before each halving
    fc_width: int = 512
    dropout: float = 0.0
    norm: Literal["batch", "group"] = "batch"  # over a step's images, or within each; vgg16 has none
    angle_bins: tuple[int, int, int] = (30, 13, 30)  # in-plane a, tilt b, spin c
    depth_bins: int = 140
    depth: Literal["absolute", "relative"] = "relative"  # bins over camera distance, or about the region's median
    depth_margin: float = 0.75  # relative: half range in diameters; absolute: margin beyond the training set's depths
    orientation: Literal["allocentric", "egocentric"] = "allocentric"
    interpolate: bool = True  # read a bin's neighbors for a value inside it
    regress_rotation: bool = True  # a 6D rotation under the Sym loss, offered as one more hypothesis
    offset: bool = True  # without: the box center stands in for the projected center
    confidence: Literal["product", "learned"] = "learned"  # score of a hypothesis before registration
    registration: bool = True
    registration_blocks: int = 4
    registration_width: int = 64
    registration_neighbours: int = 48
    registration_cells: int = 0  # it also sees shared features, so many cells a side of each hypothesis's box; 0: none
    hypotheses: int = 5  # per detection
    max_detections: int = 64


@dataclass(frozen=True)
class LossConfig:
    """Weights of the losses and how labels are made soft."""

    detection: float = 1.0
    offset: float = 8.0
    depth: float = 0.7
    angles: float = 1.0
    rotation: float = 0.5
    scoring: float = 0.5
    offset_norm: Literal["l1", "smooth-l1"] = "smooth-l1"
    angle_sigma: float = 0.6  # bins; 0: one-hot labels
    depth_sigma: float = 1.2  # bins; 0: one-hot labels
    registration_weights: Literal["paper", "balanced"] = "balanced"
    tasks: tuple[str, ...] = TASKS  # heads that learn; the losses of the others are off


@dataclass(frozen=True)
class TrainConfig:
    """The schedule."""

    batch_images: int = 8
    rois_per_image: int = 16
    optimizer: Literal["adam", "adamw", "muon"] = "muon"
    learning_rate: float = 1.5e-3
    weight_decay: float = 1e-2
    schedule: Literal["trapezoid", "one-cycle", "cosine", "constant"] = "trapezoid"
    warmup: float = 0.08  # share of the run until the peak; cosine begins at its peak
    decay: float = 0.45  # share of the run in which trapezoid falls
    ema: float = 0.0  # decay of the moving average of the weights that is validated and kept; 0: none
    clip_gradient: float = 20.0
    object_pixels: float = 67.0  # images are reduced until objects are about so large; 0: never
    # Instances of less returned visibility do not train: of what the sensor lost, nothing in the image speaks.
    min_visibility: float = 0.2
    box_jitter: float = 0.08  # of a box's side, uniform
    cut_frames: bool = True  # most steps show parts of their images, whose edges cut objects
    # Errors of depth cameras drawn on the fly, half as large on shards that have a camera's already; both 0: none.
    augment_noise: float = 0.015  # largest standard deviation of depth, and step of it, in diameters
    augment_holes: float = 0.05  # largest share of holes on smooth surface
    # Largest error, in diameters, of the depth about which half of the images are shown: what stands around a bin moves
    # an image's median, and must not move what the network makes of the parts.
    reference_jitter: float = 3.0
    scoring_images: int = 2  # images of a batch that train confidence and registration
    scoring_every: int = 2  # steps
    scoring_rate: float = (
        1.75  # times the learning rate: what is learned from few, detached hypotheses needs larger steps
    )
    scoring_start: float = 0.25  # share of the run after which they do
    scoring_overlap: float = 0.0  # boxes they learn from may overlap by this IoU: duplicates; 0: as in prediction
    validation_share: float = 0.05  # of the scenes
    validation_images: int = 48
    validations: int = 8
    # When neither --epochs nor --minutes is given: so many images or minutes, whichever are over first; without
    # images (0) so many epochs.
    images: int = 48_000
    minutes: float = 45.0
    epochs: int = 20
    precision: Literal["auto", "32", "bf16"] = "auto"


@dataclass(frozen=True)
class Config:
    """Everything that decides what a run does, beside its data."""

    preset: str
    network: NetworkConfig = field(default_factory=NetworkConfig)
    loss: LossConfig = field(default_factory=LossConfig)
    train: TrainConfig = field(default_factory=TrainConfig)

    def to_json(self) -> dict[str, Any]:
        return dataclasses.asdict(self)

    @classmethod
    def from_json(cls, document: Any, where: str = "config") -> Config:
        """Read what :meth:`to_json` writes.

        Raises:
            InputError: a field is unknown to this version, missing or of another type.
        """
        if not isinstance(document, dict):
            raise InputError(f"{where}: expected the configuration of a network.")
        before = {name: _BEFORE.get(name, {}) | part for name, part in document.items() if isinstance(part, dict)}
        return typed(cls, document | before, where, complete=False)


# What files say that were written before there was a choice.
_BEFORE: dict[str, dict[str, Any]] = {
    "network": {"crop_widths": (32, 64, 64), "crop_layers": 1},
    "train": {"object_pixels": 0.0, "images": 0, "validations": 4, "cut_frames": False, "reference_jitter": 0.0},
}


def small() -> Config:
    """Two CPU cores, minutes."""
    return Config("small")


def paper() -> Config:
    """Sock et al. 2018: VGG16, Faster R-CNN, hard bins over absolute depth, Adam 1e-5, joint registration."""
    return Config(
        "paper",
        NetworkConfig(
            backbone="vgg16",
            input="depth-holes",
            detector="rpn",
            roi="box",
            roi_size=7,
            crop_size=0,
            fc_width=4096,
            dropout=0.5,
            depth="absolute",
            depth_margin=0.05,
            interpolate=False,
            regress_rotation=False,
            confidence="product",
            registration_blocks=16,
            registration_width=128,
            registration_neighbours=128,
            registration_cells=7,
        ),
        LossConfig(
            offset=1.0,
            depth=1.0,
            offset_norm="l1",
            angle_sigma=0.0,
            depth_sigma=0.0,
            scoring=1.0,
            registration_weights="paper",
        ),
        TrainConfig(
            batch_images=1,
            object_pixels=0.0,
            cut_frames=False,
            augment_noise=0.0,
            augment_holes=0.0,
            reference_jitter=0.0,
            images=0,
            validations=4,
            rois_per_image=32,
            optimizer="adam",
            learning_rate=1e-5,
            weight_decay=0.0,
            schedule="constant",
            box_jitter=0.1,
            scoring_images=1,
            scoring_every=1,
            scoring_rate=1.0,
            scoring_overlap=0.75,
        ),
    )


def debug() -> Config:
    """Seconds: for tests and for trying a pipeline out."""
    return Config(
        "debug",
        NetworkConfig(
            backbone="vgg_debug",
            crop_size=32,
            crop_widths=(32, 64, 64),
            crop_layers=1,
            fc_width=256,
            registration_blocks=1,
        ),
        train=TrainConfig(
            batch_images=4,
            box_jitter=0.04,
            cut_frames=False,
            augment_noise=0.0,
            augment_holes=0.0,
            reference_jitter=0.0,
            validation_images=8,
            validations=1,
            images=0,
        ),
    )


PRESETS = {"paper": paper, "small": small, "debug": debug}


def preset(name: str) -> Config:
    """The named preset.

    Raises:
        InputError: there is no preset of that name.
    """
    if name not in PRESETS:
        raise InputError(f"preset '{name}' is not known; use one of {', '.join(PRESETS)}.")
    return PRESETS[name]()


def with_options(config: Config, section: str, **options: Any) -> Config:
    """`config` with fields of one section ('network', 'loss' or 'train') replaced; options that are None are left.

    Raises:
        InputError: a value is none of those that the field allows.
    """
    chosen = {key: value for key, value in options.items() if value is not None}
    part = getattr(config, section)
    unknown = sorted(set(chosen.get("tasks", ())) - set(TASKS))
    if unknown:
        raise InputError(f"option tasks: '{', '.join(unknown)}' is none of {', '.join(TASKS)}.")
    changed = typed(type(part), dataclasses.asdict(part) | chosen, "option", complete=False)
    return dataclasses.replace(config, **{section: changed})
