"""The report: one page that needs nothing else, says nothing wrong, and shows in a browser."""

from __future__ import annotations

import csv
import hashlib
import json
import re
import shutil
from dataclasses import replace
from html.parser import HTMLParser

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from evalkit import (
    GroundTruth,
    GroundTruthImage,
    PredictionImage,
    Predictions,
    average_precision,
    write_ground_truth,
    write_predictions,
)
from evalkit.commands.cli import main
from evalkit.datasets.ground_truth import read_ground_truth
from evalkit.datasets.scene import Instances, View
from evalkit.datasets.shard_format import ShardHeader
from evalkit.datasets.shard_writer import ShardWriter
from evalkit.geometry import poses
from evalkit.geometry.camera import Camera
from evalkit.objects.model import ObjectModel
from evalkit.reports.report import figures_folder, save_report

CAMERA = Camera(80, 60, 80.0, 80.0, 39.5, 29.5)
CHARTS = {
    "precision_recall", "scores", "reliability", "ap_by_threshold", "ap_by_criterion", "rotation_errors",
    "translation_errors", "ap_by_visibility",
}  # fmt: skip
SECTIONS = ("figures", "images", "published", "protocol")
VOID = {"meta", "img", "br"}


@pytest.fixture(scope="module")
def shards(tmp_path_factory):
    """Six frames of two tiles each, 80 x 60."""
    square = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * 0.05
    header = ShardHeader(CAMERA, 1e-4, ObjectModel.from_mesh("tile", square, [[0, 1, 2], [0, 2, 3]]))
    rng = np.random.default_rng(0)
    folder = tmp_path_factory.mktemp("shards")
    with ShardWriter(folder / "shard-00000.h5", header, frames=6) as writer:
        for frame in range(6):
            place = poses.from_rotation_translation(poses.random_rotations(rng, 2), [[-0.1, 0, 0.5], [0.1, 0, 0.5]])
            depth = rng.integers(5500, 6500, (60, 80)).astype(np.uint16)
            labels = Instances(np.arange(2), place, *np.array([[1.0, 0.3], [0.9, 0.2]]), *np.ones((3, 2), int),
                               *np.zeros((2, 2, 4), int), np.zeros((2, 2)))  # fmt: skip
            writer.append(
                View(CAMERA, depth, 1e-4, np.zeros((60, 80), np.uint16), np.eye(4), labels, frame // 2, frame % 2)
            )
    return folder


@pytest.fixture(scope="module")
def documents(shards):
    """The shards' ground truth, and predictions of which some are true and some are false."""
    truth = read_ground_truth(shards)
    off = poses.from_rotation_translation(poses.from_axis_angle([0, 0, 1.0], 0.02), [1e-3, 0, 0])
    wrong = poses.from_rotation_translation(np.diag([1.0, -1, -1]), [0.0, 0.05, 0.55])
    images = [
        PredictionImage(
            image.id, np.concatenate([image.cam_from_obj[: number % 3] @ off, wrong[None]]),
            np.r_[np.linspace(0.9, 0.8, min(number % 3, 2)), 0.3 + 0.1 * number], 0.25,
        )
        for number, image in enumerate(truth.images)
    ]  # fmt: skip
    return Predictions("tile", images), truth


@pytest.fixture(scope="module")
def folder(documents, shards, tmp_path_factory):
    """What the command writes."""
    place = tmp_path_factory.mktemp("report")
    write_predictions(place / "preds.json", documents[0])
    write_ground_truth(place / "gt.json", documents[1])
    files = [place / "preds.json", place / "gt.json", "--shards", shards, "-o", place / "report.html", "--images", 4]
    done = CliRunner().invoke(main, ["report", *map(str, files)], catch_exceptions=False)
    assert done.exit_code == 0
    assert "report_figures" in done.output
    return place


@pytest.fixture
def page(folder):
    return (folder / "report.html").read_text(encoding="utf-8")


class Checked(HTMLParser):
    """Reads a page as strictly as it can be written: every tag closed in order, every id once, links that lead."""

    def __init__(self, page):
        super().__init__()
        self.open, self.ids, self.images, self.links, self.words = [], [], [], [], []
        self.feed(page)
        assert self.open == []
        assert len(self.ids) == len(set(self.ids))
        assert {link.removeprefix("#") for link in self.links} <= set(self.ids)

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        assert tag not in ("script", "link", "iframe", "object", "form")
        assert not any(name.startswith("on") for name in given)
        self.ids += [given["id"]] if "id" in given else []
        self.links += [given["href"]] if "href" in given else []
        self.images += [given["src"]] if "src" in given else []
        self.open += [] if tag in VOID else [tag]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)


def rows_of(path):
    with open(path, newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_the_page_has_every_section_and_every_figure(page):
    checked = Checked(page)
    assert set(SECTIONS) | CHARTS | {f"overlay-{n}" for n in range(1, 5)} <= set(checked.ids)
    assert len(checked.images) == len(CHARTS) + 4


def test_the_page_needs_no_network(page):
    checked = Checked(page)
    assert all(source.startswith("data:image/") for source in checked.images)
    assert all(link.startswith("#") for link in checked.links)
    assert not re.search(r"https?://|url\(|@import|//cdn", page)
    assert "default-src 'none'" in page


def test_the_page_says_rules_counts_versions_and_hashes(page, folder, documents):
    result = average_precision(*documents)
    words = " ".join("".join(Checked(page).words).split())
    assert result.protocol in words
    assert f"AP {result.ap:.3f}" in words
    assert f"{result.counts['instances']}; to find: {result.counts['instances_to_find']}" in words
    for name in ("preds.json", "gt.json"):
        assert hashlib.sha256((folder / name).read_bytes()).hexdigest() in words


def test_every_figure_lies_beside_the_page_as_picture_and_table(folder):
    for name in CHARTS:
        picture = cv2.imread(str(folder / "report_figures" / f"{name}.png"))
        assert picture.std() > 5
        assert rows_of(folder / "report_figures" / f"{name}.csv")
    for number in range(1, 5):
        assert cv2.imread(str(folder / "report_figures" / f"overlay-{number}.png")) is not None


def test_the_numbers_beside_the_curve_give_the_ap(folder, documents):
    rows = rows_of(folder / "report_figures" / "precision_recall.csv")
    precision, recall = (np.array([float(row[key]) for row in rows]) for key in ("precision", "recall"))
    assert (precision * np.diff(recall, prepend=0.0)).sum() == pytest.approx(
        average_precision(*documents).ap, abs=1e-12
    )


def test_histograms_hold_every_hypothesis_once(folder, documents):
    counts = average_precision(*documents).counts
    rows = rows_of(folder / "report_figures" / "scores.csv")
    for kind in ("true", "false", "ignored"):
        assert sum(int(row[kind]) for row in rows) == counts[kind]


def test_the_table_of_images_is_worst_first_and_names_the_pictures(folder, documents):
    rows = rows_of(folder / "report_figures" / "images.csv")
    assert sorted(row["id"] for row in rows) == sorted(image.id for image in documents[1].images)
    aps = [float(row["ap"]) for row in rows]
    assert aps == sorted(aps)
    assert [row["overlay"] for row in rows[:2]] == ["overlay-1.png", "overlay-2.png"]
    assert len({row["overlay"] for row in rows} - {""}) == 4


def test_another_run_gives_the_same_page_and_leaves_no_picture_of_the_one_before(documents, shards, tmp_path):
    pages = []
    for count in (1, 2, 1):
        save_report(tmp_path / "r.html", *documents, shards, count)
        pages.append((tmp_path / "r.html").read_bytes())
    assert pages[0] == pages[2] != pages[1]
    assert len(list((tmp_path / "r_figures").glob("overlay-*.png"))) == 1


def test_the_published_table_stands_beside_ours_with_a_warning(page):
    words = " ".join("".join(Checked(page).words).split())
    assert "Not comparable" in words
    assert "rendered by simgen" in words
    assert "BMVC 2018" in words


NASTY = "<script>alert('x')</script>\"><img src=x onerror=alert(1)> & $\\frac{$"


def test_whatever_a_user_names_is_escaped(documents, tmp_path):
    predictions, truth = documents
    images = [replace(image, id=f"{NASTY}{number}") for number, image in enumerate(truth.images)]
    named = replace(truth, object=replace(truth.object, name=NASTY), images=images)
    hypotheses = [replace(h, id=image.id) for h, image in zip(predictions.images, images, strict=True)]
    inputs = {"predictions": {"file": NASTY, "sha256": "0"}}
    save_report(tmp_path / "r.html", replace(predictions, object=NASTY, images=hypotheses), named, inputs=inputs)
    page = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert "<script" not in page
    assert len(Checked(page).images) == len(CHARTS)
    assert NASTY in "".join(Checked(page).words)


def crowd_of(model, counts, hypotheses):
    """Images with so many instances, at one place, and so many hypotheses at the same; None leaves the image out."""
    at = poses.from_rotation_translation(np.eye(3), [0.0, 0.0, 0.5])
    truth = [GroundTruthImage(f"i{n}", CAMERA, np.tile(at, (c, 1, 1)), np.ones(c)) for n, c in enumerate(counts)]
    found = [
        PredictionImage(f"i{n}", np.tile(at, (h, 1, 1)), np.ones(h)) for n, h in enumerate(hypotheses) if h is not None
    ]
    return Predictions(model.name, found), GroundTruth(model, truth)


@pytest.mark.parametrize(
    ("counts", "hypotheses"),
    [([2, 1], [None, None]), ([0, 0], [0, 3]), ([1], [1]), ([0], [None])],
    ids=["nothing predicted", "nothing to find", "one, and found", "nothing at all"],
)
def test_little_or_nothing_still_makes_a_sensible_page(plain_model, tmp_path, counts, hypotheses):
    save_report(tmp_path / "r.html", *crowd_of(plain_model, counts, hypotheses))
    checked = Checked((tmp_path / "r.html").read_text(encoding="utf-8"))
    assert set(SECTIONS) | CHARTS <= set(checked.ids)
    assert not re.search(r"\b(nan|inf|None)\b", "".join(checked.words))


@pytest.mark.parametrize("rules", [
    {"protocol": "coco", "criterion": "mspd"}, {"protocol": "sileane-toolbox", "min_visibility": -1.0},
    {"criterion": "adds", "threshold": 0.2, "max_results": 1},
], ids=str)  # fmt: skip
def test_a_page_is_made_by_any_rules(documents, tmp_path, rules):
    save_report(tmp_path / "r.html", *documents, **rules)
    words = "".join(Checked((tmp_path / "r.html").read_text(encoding="utf-8")).words)
    assert f"AP {average_precision(*documents, **rules).ap:.3f}" in words


@pytest.mark.parametrize("unit", [-1e308, 1e-320])
def test_scores_on_any_scale_are_drawn(plain_model, tmp_path, unit):
    predictions, truth = crowd_of(plain_model, [1], [4])
    scores = replace(predictions.images[0], score=unit * np.array([1.0, -1.0, 0.5, 0.0]))
    save_report(tmp_path / "r.html", replace(predictions, images=[scores]), truth)
    rows = rows_of(tmp_path / "r_figures" / "scores.csv")
    assert sum(int(row["true"]) + int(row["false"]) for row in rows) == 4


def test_long_curves_do_not_make_long_pages(plain_model, tmp_path):
    predictions, truth = crowd_of(plain_model, [1], [9000])
    spread = replace(predictions.images[0], score=np.linspace(0, 1, 9000))
    save_report(tmp_path / "r.html", replace(predictions, images=[spread]), truth)
    assert (tmp_path / "r.html").stat().st_size < 1_000_000


@pytest.mark.parametrize(
    "arguments",
    [
        ["-o", "report.pdf"], ["-o", "gt.json/report.html"], ["-o", "r.html", "--shards", "absent"],
        ["-o", "r.html", "--shards", "."], ["-o", "r.html", "--threshold", "0"], ["-o", "r.html", "--images", "0"], [],
    ],
    ids=" ".join,
)  # fmt: skip
def test_wrong_input_gets_one_sentence_and_exit_code_2(folder, tmp_path, monkeypatch, arguments):
    for name in ("preds.json", "gt.json"):
        shutil.copy(folder / name, tmp_path)
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(main, ["report", "preds.json", "gt.json", *arguments], catch_exceptions=False)
    assert done.exit_code == 2
    assert len([line for line in done.output.splitlines() if line.startswith("Error: ")]) == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["gt.json", "preds.json"]


def test_shards_of_other_images_are_refused(documents, shards, tmp_path):
    predictions, truth = documents
    other = replace(truth, images=[replace(image, id=f"x{image.id}") for image in truth.images])
    with pytest.raises(ValueError, match="none of the images"):
        save_report(tmp_path / "r.html", replace(predictions, images=[]), other, shards)
    assert not figures_folder(tmp_path / "r.html").exists()


PROBE = """<script>
window.blocked = 0;
document.addEventListener('securitypolicyviolation', () => { window.blocked += 1; });
window.addEventListener('load', () => {
  const images = [...document.images];
  document.documentElement.dataset.probe = JSON.stringify({
    images: images.length,
    broken: images.filter(image => !(image.complete && image.naturalWidth > 0)).length,
    blocked: window.blocked,
    fetched: performance.getEntriesByType('resource').filter(e => !e.name.startsWith('data:')).map(e => e.name),
    width: document.documentElement.clientWidth,
    overflow: document.documentElement.scrollWidth - document.documentElement.clientWidth,
    heights: ['figures', 'images', 'published', 'protocol'].map(id => document.getElementById(id).offsetHeight),
  });
});
</script>"""


@pytest.mark.parametrize("width", [1280, 500])
def test_a_browser_loads_every_picture_asks_for_nothing_and_fits_the_width(page, chromium, tmp_path, width):
    probed = page.replace("default-src 'none'", "default-src 'none'; script-src 'unsafe-inline'")
    (tmp_path / "probed.html").write_text(probed.replace("<title>", f"{PROBE}<title>", 1), encoding="utf-8")
    address = (tmp_path / "probed.html").as_uri()
    dom = chromium(f"--window-size={width},900", "--dump-dom", address)
    found = json.loads(re.search(r'data-probe="([^"]*)"', dom)[1].replace("&quot;", '"'))
    assert found["images"] == len(CHARTS) + 4
    assert (found["broken"], found["blocked"], found["fetched"]) == (0, 0, [])
    assert found["width"] <= width
    assert found["overflow"] <= 0
    assert min(found["heights"]) > 100


def test_a_browser_shows_the_page(folder, chromium, tmp_path):
    picture = tmp_path / "page.png"
    address = (folder / "report.html").as_uri()
    chromium("--window-size=1280,3000", f"--screenshot={picture}", address)
    shown = cv2.imread(str(picture))
    assert shown.shape[:2] == (3000, 1280)
    assert shown.std() > 20
    blue = np.abs(shown.astype(int) - (168, 95, 31)).max(-1) < 12  # the curves' color, BGR
    assert blue.sum() > 2000


def test_images_of_the_same_names_that_show_other_scenes_are_refused(documents, shards, tmp_path):
    predictions, truth = documents
    turned = [replace(image, cam_from_obj=image.cam_from_obj[::-1] * [[1], [-1], [-1], [1]]) for image in truth.images]
    with pytest.raises(ValueError, match="shows other instances"):
        save_report(tmp_path / "r.html", replace(predictions, images=[]), replace(truth, images=turned), shards)
    assert not (tmp_path / "r.html").exists()
