"""What is written is read back, damage is noticed, and a shard is complete or absent."""

from __future__ import annotations

import errno
import json
import multiprocessing
import pickle
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from evalkit.datasets.scene import Instances, View
from evalkit.datasets.shard_folder import (
    DATASET_FILE,
    ShardDataset,
    list_shards,
    read_dataset_file,
    shard_name,
    write_dataset_file,
)
from evalkit.datasets.shard_format import COMPRESSIONS, ShardHeader, checksum_problem
from evalkit.datasets.shard_reader import ShardReader
from evalkit.datasets.shard_writer import ShardWriter
from evalkit.errors import InputError
from evalkit.geometry import poses
from evalkit.geometry.camera import Camera
from evalkit.objects.model import ObjectModel
from evalkit.objects.symmetry import Symmetry

CAMERA = Camera(20, 15, 30.0, 31.0, 9.5, 7.0)
TETRA = (np.vstack([np.zeros(3), 0.1 * np.eye(3)]), np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]))
MODEL = ObjectModel.from_mesh("tetra", *TETRA, Symmetry.parse("cyclic:3"), source="tetra.stl")
HEADER = ShardHeader(CAMERA, 1e-4, MODEL, {"scenes": 2}, seed=7, software={"numpy": "2"})


def random_view(scene: int, view: int) -> View:
    """Arbitrary pixels and labels: the file must not care."""
    rng = np.random.default_rng([scene, view])
    n = int(rng.integers(0, 5))
    labels = Instances(
        instance=np.arange(n, dtype=np.int32),
        cam_from_obj=poses.from_rotation_translation(poses.random_rotations(rng, n), rng.normal(size=(n, 3))),
        visibility_geometric=rng.random(n, np.float32),
        visibility_returned=rng.random(n, np.float32),
        pixels_geometric=rng.integers(0, 99, n, np.int32),
        pixels_returned=rng.integers(0, 99, n, np.int32),
        pixels_full=rng.integers(0, 99, n, np.int32),
        box_returned=rng.integers(0, 20, (n, 4), np.int32),
        box_full=rng.integers(-50, 50, (n, 4), np.int32),
        center_px=rng.normal(size=(n, 2)).astype(np.float32),
    )
    pixels = rng.integers(0, 2**16, (2, 15, 20), np.uint16)
    world = poses.from_rotation_translation(poses.random_rotations(rng, 1)[0], rng.normal(size=3))
    return View(CAMERA, pixels[0], 1e-4, pixels[1], world, labels, scene, view)


VIEWS = [random_view(scene, view) for scene in range(4) for view in range(3)]


def write_shard(path: Path, views: list[View], header: ShardHeader = HEADER, compression: str = "zstd") -> None:
    with ShardWriter(path, header, len(views), compression) as writer:
        for view in views:
            writer.append(view)


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_noise_in_the_low_byte_does_not_keep_depth_from_being_compressed(tmp_path: Path, compression: str) -> None:
    camera = Camera(200, 150, 300.0, 310.0, 95.0, 70.0)
    noisy = np.random.default_rng(0).integers(5_120, 5_376, (150, 200), np.uint16)
    view = replace(VIEWS[0], camera=camera, depth_raw=noisy, instance_id=np.zeros_like(noisy))
    write_shard(tmp_path / "one.h5", [view], replace(HEADER, camera=camera), compression)
    with h5py.File(tmp_path / "one.h5") as file:
        assert file["depth"].id.get_storage_size() < 0.51 * noisy.nbytes


def test_bytes_do_not_depend_on_when_python_lets_go_of_objects(tmp_path: Path) -> None:
    """A profiler, as in every worker of Dask, holds frames and thereby HDF5's handles for a while."""
    write_shard(tmp_path / "plain.h5", VIEWS)
    held: list[object] = []
    for every in (1, 7, 31):
        count = iter(range(10**9))

        def hold(frame: object, *_: object, every: int = every, count: Iterator[int] = count) -> None:
            if next(count) % every == 0:
                held.append(frame)

        sys.setprofile(hold)
        try:
            write_shard(tmp_path / "watched.h5", VIEWS)
        finally:
            sys.setprofile(None)
        assert (tmp_path / "watched.h5").read_bytes() == (tmp_path / "plain.h5").read_bytes()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two shards of two scenes each, and dataset.json."""
    for shard in range(2):
        write_shard(tmp_path / shard_name(shard), VIEWS[6 * shard : 6 * shard + 6])
    listed = [{"name": shard_name(shard), "scenes": [2 * shard, 2 * shard + 2]} for shard in range(2)]
    write_dataset_file(tmp_path, HEADER, listed)
    return tmp_path


def assert_same_view(view: View, expected: View) -> None:
    for field in ("depth_raw", "instance_id", "cam_from_world"):
        assert np.array_equal(getattr(view, field), getattr(expected, field))
    for field in fields(Instances):
        stored, wanted = getattr(view.instances, field.name), getattr(expected.instances, field.name)
        assert stored.dtype == wanted.dtype and np.array_equal(stored, wanted), field.name
    assert (view.image_id, view.camera, view.depth_unit) == (expected.image_id, CAMERA, 1e-4)


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_what_is_written_is_read_back(tmp_path: Path, compression: str) -> None:
    write_shard(tmp_path / "shard-00000.h5", VIEWS, compression=compression)
    with ShardReader(tmp_path / "shard-00000.h5") as reader:
        assert len(reader) == len(VIEWS)
        for view, expected in zip(reader, VIEWS, strict=True):
            assert_same_view(view, expected)
        assert_same_view(reader[-1], VIEWS[-1])
        assert np.array_equal(reader.depth_raw(3), VIEWS[3].depth_raw)
        assert len(reader.labels(4)) == len(VIEWS[4].instances)
        head = reader.header
    assert (head.config, head.seed, head.software) == (HEADER.config, 7, HEADER.software)
    assert head.object.symmetry.name == "cyclic:3" and head.object.notes == {"source": "tetra.stl"}
    assert np.array_equal(head.object.vertices, MODEL.vertices) and np.array_equal(head.object.faces, MODEL.faces)


def test_ideal_depth_is_read_back_where_it_was_kept(tmp_path: Path) -> None:
    views = [replace(view, depth_ideal_raw=view.depth_raw[::-1].copy()) for view in VIEWS[:2]]
    for keep in (True, False):
        with ShardWriter(tmp_path / "s.h5", HEADER, 2, keep_ideal=keep) as writer:
            for view in views:
                writer.append(view)
        with ShardReader(tmp_path / "s.h5") as reader:
            assert reader.has_ideal == keep
            for view, expected in zip(reader, views, strict=True):
                assert_same_view(view, expected)
                if keep:
                    assert np.array_equal(view.depth_ideal_raw, expected.depth_raw[::-1])
                    assert np.array_equal(view.depth_ideal, expected.depth[::-1])
                else:
                    assert view.depth_ideal_raw is None and view.depth_ideal is None


def test_ideal_depth_that_is_not_there_cannot_be_kept(tmp_path: Path) -> None:
    with (
        pytest.raises(InputError, match="no ideal depth"),
        ShardWriter(tmp_path / "s.h5", HEADER, 1, keep_ideal=True) as writer,
    ):
        writer.append(VIEWS[0])
    assert list(tmp_path.iterdir()) == []


def test_the_same_views_make_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a.h5", "b.h5"):
        write_shard(tmp_path / name, VIEWS)
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()


def test_a_header_too_long_for_an_attribute_is_kept(tmp_path: Path) -> None:
    header = replace(HEADER, config={"text": "x" * 200_000})
    write_shard(tmp_path / "shard-00000.h5", VIEWS[:1], header)
    with ShardReader(tmp_path / "shard-00000.h5") as reader:
        assert reader.header.config == header.config


def test_a_shard_without_instances_can_be_read(tmp_path: Path) -> None:
    nobody = replace(VIEWS[0], instances=VIEWS[0].instances[:0])
    write_shard(tmp_path / "shard-00000.h5", [nobody])
    with ShardReader(tmp_path / "shard-00000.h5") as reader:
        assert len(reader[0].instances) == 0 and reader[0].instances.cam_from_obj.shape == (0, 4, 4)


@pytest.mark.parametrize("failure", [ValueError, KeyboardInterrupt])
def test_an_interrupted_shard_leaves_nothing(tmp_path: Path, failure: type[BaseException]) -> None:
    with pytest.raises(failure), ShardWriter(tmp_path / "shard-00000.h5", HEADER, 3) as writer:
        writer.append(VIEWS[0])
        raise failure
    assert list(tmp_path.iterdir()) == []


def test_a_shard_of_too_few_frames_is_not_made(tmp_path: Path) -> None:
    with (
        pytest.raises(InputError, match="1 frames written where 3"),
        ShardWriter(tmp_path / "s.h5", HEADER, 3) as writer,
    ):
        writer.append(VIEWS[0])
    assert list(tmp_path.iterdir()) == []


def test_an_unknown_compression_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="zstd"):
        ShardWriter(tmp_path / "s.h5", HEADER, 1, "lzma")


def test_every_changed_byte_breaks_the_checksum(folder: Path) -> None:
    path = folder / shard_name(0)
    whole = path.read_bytes()
    assert checksum_problem(path) is None
    for place in np.random.default_rng(0).integers(0, len(whole), 40):
        damaged = bytearray(whole)
        damaged[place] ^= 1
        path.write_bytes(bytes(damaged))
        if whole[place] != 0 or place >= 512:  # the rest of the first 512 bytes is padding
            assert checksum_problem(path) is not None, place
    path.write_bytes(whole[:-1])
    assert checksum_problem(path) is not None


def test_a_missing_file_has_a_checksum_problem(tmp_path: Path) -> None:
    assert checksum_problem(tmp_path / "missing.h5") is not None


@pytest.mark.parametrize("share", [0.0, 0.01, 0.3, 0.7, 0.99])
def test_a_truncated_shard_is_refused_by_name(folder: Path, share: float) -> None:
    path = folder / shard_name(0)
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    with pytest.raises(InputError, match=path.name):
        ShardReader(path)


def test_damaged_pixels_are_refused_not_returned(folder: Path) -> None:
    path = folder / shard_name(0)
    with h5py.File(path) as file:
        info = file["depth"].id.get_chunk_info(2)
    data = bytearray(path.read_bytes())
    data[info.byte_offset + 512 + info.size // 2] ^= 0xFF
    path.write_bytes(bytes(data))
    with ShardReader(path) as reader:
        assert_same_view(reader[1], VIEWS[1])
        with pytest.raises(InputError, match="frame 2 is damaged"):
            reader[2]


def test_other_files_are_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "shard-00000.h5").write_text("not HDF5")
    with h5py.File(tmp_path / "shard-00001.h5", "w") as file:
        file["x"] = 1
    for name in ("shard-00000.h5", "shard-00001.h5", "missing.h5"):
        with pytest.raises(InputError, match=name):
            ShardReader(tmp_path / name)


def test_a_folder_is_one_sequence(folder: Path) -> None:
    dataset = ShardDataset(folder)
    assert len(dataset) == len(VIEWS)
    for index in (0, 5, 6, 11, -1, -12):
        assert_same_view(dataset[index], VIEWS[index])
    assert [view.image_id for view in dataset[4:8]] == [view.image_id for view in VIEWS[4:8]]
    assert dataset.scene_index.tolist() == [view.scene_index for view in VIEWS]
    for beyond in (12, -13):
        with pytest.raises(IndexError):
            dataset[beyond]


def read_depth(dataset: ShardDataset, index: int) -> np.ndarray:
    return dataset[index].depth_raw


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_a_dataset_can_be_used_in_other_processes(folder: Path, method: str) -> None:
    dataset = ShardDataset(folder)
    dataset[0]  # an open file must not be shared
    with multiprocessing.get_context(method).Pool(1) as pool:
        depth = pool.apply(read_depth, (dataset, 7))
    assert np.array_equal(depth, VIEWS[7].depth_raw)
    assert_same_view(pickle.loads(pickle.dumps(dataset))[3], VIEWS[3])  # noqa: S301 - our own bytes


def test_shards_are_listed_from_a_folder_a_file_or_several(folder: Path) -> None:
    paths = [folder / shard_name(0), folder / shard_name(1)]
    assert list_shards(folder) == paths
    assert list_shards(paths[1]) == [paths[1]]
    assert list_shards([paths[1], folder]) == [paths[1], *paths]


def test_what_does_not_belong_is_left_out_and_what_is_missing_is_told(folder: Path) -> None:
    write_shard(folder / shard_name(5), VIEWS[:1])
    assert len(list_shards(folder)) == 2
    (folder / shard_name(0)).unlink()
    with pytest.raises(InputError, match="shard-00000"):
        list_shards(folder)


def test_shards_of_different_objects_do_not_mix(folder: Path) -> None:
    other = replace(HEADER, object=replace(MODEL, name="other"))
    write_shard(folder / "elsewhere" / shard_name(0), VIEWS[:1], other)
    with pytest.raises(InputError, match="differs"):
        ShardDataset([folder, folder / "elsewhere"])


def test_nothing_there_is_told(tmp_path: Path) -> None:
    for source in (tmp_path, tmp_path / "missing"):
        with pytest.raises(InputError, match="simgen build"):
            ShardDataset(source)


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"format": "else", "shards": []}', '{"format": "binpose-dataset/1"}']
)
def test_a_strange_dataset_file_is_refused(folder: Path, text: str) -> None:
    (folder / DATASET_FILE).write_text(text)
    with pytest.raises(InputError, match=DATASET_FILE):
        list_shards(folder)


def test_the_dataset_file_names_what_the_shards_hold(folder: Path) -> None:
    document = read_dataset_file(folder)
    assert json.loads(json.dumps(document)) == document
    assert (document["seed"], document["config"]) == (7, {"scenes": 2})
    assert Camera.from_json(document["camera"]) == CAMERA
    assert ObjectModel.from_json(document["object"]).name == "tetra"


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 200 KB, where this user may mount one."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=200k", "tmpfs", str(folder)]
    if shutil.which("mount") is None or subprocess.run(mount, capture_output=True, check=False).returncode != 0:
        pytest.skip("mounting is not allowed here")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=False)


def fill(path: Path, frames: int) -> None:
    with ShardWriter(path, HEADER, frames) as writer:
        for frame in range(frames):
            writer.append(random_view(0, frame))


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # h5py tells of each lost buffer
def test_a_full_disk_is_an_os_error_that_names_the_shard_and_leaves_no_file(small_disk: Path) -> None:
    fill(small_disk / shard_name(0), 3)
    for frames in (100, 300, 1000):  # full at the labels, among the frames, early
        with pytest.raises(OSError) as error:
            fill(small_disk / shard_name(1), frames)
        assert error.value.errno == errno.ENOSPC and error.value.filename == str(small_disk / shard_name(1))
        assert [path.name for path in small_disk.iterdir()] == [shard_name(0)]


def test_hdf5s_runtime_error_about_a_full_disk_is_told_as_an_os_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise RuntimeError("Disable slist on flush dest failure failed (file write failed: errno = 28, error message)")

    monkeypatch.setattr(ShardWriter, "_write_labels", fail)
    with pytest.raises(OSError, match="No space left") as error:
        fill(tmp_path / shard_name(0), 2)
    assert error.value.errno == errno.ENOSPC and not list(tmp_path.iterdir())
    with pytest.raises(RuntimeError, match="of another kind"), ShardWriter(tmp_path / shard_name(0), HEADER, 2):
        raise RuntimeError("of another kind")
