"""The figures that papers published, with their sources, and what a run must share with them to be comparable."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from evalkit.datasets.scene import Share
from evalkit.scoring.bootstrap import OUR_IMAGE_ID
from evalkit.scoring.result import Result
from evalkit.scoring.rules import Settings, at_least

PAPER = (
    "Sock, Kim, Sahin & Kim: Multi-Task Deep Networks for Depth-Based 6D Object Pose and Joint Registration in Crowd "
    "Scenarios. BMVC 2018, arXiv:1806.03891, Table 1"
)
OURS = "Sock et al. 2018"
WITHOUT_OFFSET = f"{OURS}, without offset"
PROTOCOL = "Brégier et al. 2017"
VISIBILITY_KEPT = 0.5
PUBLISHED_SHARE: Share = "returned"  # 1 - occlusion_rate of the Siléane dataset
THRESHOLD_KEPT = 0.1
NOT_STATED = "not stated with the table"


@dataclass(frozen=True)
class Table:
    """Published figures, a row a method and a column an object.

    Attributes:
        measure: what the figures are.
        criterion: the distance they were measured with, by evalkit's name.
        min_visibility: of the instances to find; None where the table does not say.
        images: what was evaluated on.
        source: the paper, and the place in it.
    """

    key: str
    title: str
    measure: str
    criterion: str
    min_visibility: float | None
    images: str
    source: str
    columns: tuple[str, ...]
    rows: dict[str, tuple[float, ...]]

    def column_of(self, object_name: str) -> int | None:
        """The column about an object of this name, None where there is none."""
        name = object_name.lower()
        return next((i for i, column in enumerate(self.columns) if column.split(",")[0] in name), None)


TABLES = (
    Table(
        key="sym",
        title="Bin picking, Sym",
        measure="AP, Sym distance at most 0.1 diameters",
        criterion="sym",
        min_visibility=VISIBILITY_KEPT,
        images="the test images of the Siléane and ICVL bin-picking datasets",
        source=PAPER,
        columns=("bunny", "cup", "pepper", "candlestick"),
        rows={
            "Linemod": (0.39, 0.08, 0.04, 0.38),
            "Linemod+PP": (0.45, 0.20, 0.03, 0.49),
            "PPF": (0.29, 0.28, 0.06, 0.16),
            "PPF+PP": (0.37, 0.30, 0.12, 0.22),
            WITHOUT_OFFSET: (0.49, 0.53, 0.32, 0.53),
            OURS: (0.74, 0.55, 0.43, 0.64),
        },
    ),
    Table(
        key="add",
        title="Coffee cup in crowds, ADD",
        measure="AP, ADD",
        criterion="add",
        min_visibility=None,
        images="real images of the ICVL bin-picking dataset, and synthetic ones of the paper's own",
        source=PAPER,
        columns=("cup, real", "cup, synthetic"),
        rows={"Linemod": (0.38, 0.32), "LCHF": (0.30, 0.31), "SSD6D": (0.07, 0.01), OURS: (0.68, 0.80)},
    ),
    Table(
        key="f1",
        title="Domestic cup, F1",
        measure="F1 at a confidence, ADD",
        criterion="add",
        min_visibility=None,
        images="real images of the domestic cup",
        source=f"{PAPER}(c)",
        columns=("cup, domestic",),
        rows={
            "Linemod": (0.819,),
            "PPF": (0.867,),
            "LCHF": (0.877,),
            "Sahin et al.": (0.793,),
            "Kehl et al.": (0.972,),
            OURS: (0.992,),
        },
    ),
    Table(
        key="later",
        title="Later work on Siléane",
        measure="mean AP over objects, Sym; each over another subset of the dataset's objects",
        criterion="sym",
        min_visibility=VISIBILITY_KEPT,
        images="the test images of several Siléane objects",
        source=(
            "the abstracts of SD-Net: Symmetric-Aware Keypoint Prediction and Domain Adaptation for 6D Pose Estimation "
            "in Bin-picking Scenarios (arXiv:2403.09317) and of ParametricNet: 6DoF Pose Estimation Network for "
            "Parametric Shapes in Stacked Scenarios (ICRA 2021)"
        ),
        columns=("mean AP",),
        rows={"ParametricNet": (0.96,), "SD-Net": (0.96,)},
    ),
)


@dataclass(frozen=True)
class Condition:
    """One thing that must be the same on both sides; `holds` is None where this run cannot tell."""

    subject: str
    published: str
    here: str
    holds: bool | None


def closest_table(criterion: str) -> Table:
    """The table to be seen beside a run by this criterion: ADD's beside ADD, else Sym's."""
    return next((table for table in TABLES if table.criterion == criterion), TABLES[0])


def conditions(table: Table, result: Result) -> list[Condition]:
    """What must be the same for a figure of `table` and the AP of `result` to be compared, and whether it is.

    The images are never known to be the same, at best not known to differ.
    """
    rules = result.settings
    known = table.column_of(result.object_name) is not None
    object_holds = None if known or not result.object_name else False
    criterion = rules.criterion == table.criterion and abs(rules.threshold - THRESHOLD_KEPT) < 1e-9
    visibility = _same_instances(table, rules)
    protocol = None if rules.protocol == "sileane" else rules.protocol == "sileane-toolbox"
    simulated = any(OUR_IMAGE_ID.fullmatch(name) for name in result.image_ids)
    here = "rendered by simgen" if simulated else "gt.json does not say whose"
    stated = NOT_STATED if table.min_visibility is None else at_least(table.min_visibility, PUBLISHED_SHARE)
    best = "" if rules.max_results is None else f", the best {rules.max_results} of an image"
    exact = "; the authors' toolbox has another Sym, see --protocol sileane-toolbox" if protocol is None else ""
    return [
        Condition("images", table.images, f"{len(result.image_ids):,} images, {here}", False if simulated else None),
        Condition("object", ", ".join(table.columns), f"{result.object_title}, by name", object_holds),
        Condition("criterion", table.measure, f"{rules.criterion} at most {rules.threshold:g}", criterion),
        Condition("instances to find", stated, rules.asked, visibility),
        Condition("protocol", PROTOCOL, f"{rules.protocol}{best}{exact}", False if best else protocol),
    ]


def _same_instances(table: Table, rules: Settings) -> bool | None:
    """Whether the same instances are to be found."""
    if table.min_visibility is None:
        return None
    if abs(rules.min_visibility - table.min_visibility) > 1e-9:
        return False
    return None if rules.visibility is None else rules.visibility == PUBLISHED_SHARE


def as_text() -> str:
    """All tables with their sources, aligned."""
    return "\n\n".join(_text(table) for table in TABLES)


def to_json() -> list[dict[str, Any]]:
    return [asdict(table) for table in TABLES]


def figure(table: Table, value: float) -> str:
    """A figure with as many decimals as the table's most exact one."""
    decimals = max(len(f"{v:g}".partition(".")[2]) for values in table.rows.values() for v in values)
    return f"{value:.{decimals}f}"


def measure_sentence(table: Table) -> str:
    return f"{table.measure[0].upper()}{table.measure[1:]}."


def _text(table: Table) -> str:
    first = max(len(method) for method in table.rows)
    rows = {method: [figure(table, value) for value in values] for method, values in table.rows.items()}
    lines = [
        "  ".join(
            [method.ljust(first), *(cell.rjust(max(len(c), 5)) for c, cell in zip(table.columns, cells, strict=True))]
        )
        for method, cells in {"": table.columns, **rows}.items()
    ]
    notes = [measure_sentence(table), f"On {table.images}.", f"Source: {table.source}."]
    return "\n".join([table.title, "", *lines, "", *notes])
