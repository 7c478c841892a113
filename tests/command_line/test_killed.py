"""Tests that killed commands leave no partial file and can be continued, and that a full disk, a
closed folder and a missing input give one sentence each and change no existing file."""

import resource
from contextlib import contextmanager

import numpy as np
import pytest
from commands import called
from fuzz.seeds import TABLE
from killed import Job

import fitting.cli
import jaxvision
from jaxvision.errors import InputError
from jaxvision.files.images import write_image
from jaxvision.render_command.tiles import PartialImage, PartialSum


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "moments"), [("render", 7), ("chain", 7), ("report", 6), ("taps", 3)]
)
def test_a_killed_command_leaves_no_partial_file_and_continues(tmp_path, name, moments):
    job = Job(name, tmp_path / name)
    assert job.whole
    for moment in range(moments):
        job.killed_at(moment)


@contextmanager
def full_disk():
    """Limit files to 1000 bytes, as on a full disk. The limit does not apply after the block, so
    test reports can be written."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@full_disk()
def test_a_full_disk_is_a_sentence_that_names_the_file(tmp_path):
    picture = np.random.default_rng(0).uniform(size=(40, 40, 3)).astype(np.float32)
    for suffix in (".exr", ".png", ".hdr"):
        file = tmp_path / f"picture{suffix}"
        pixels = (255 * picture).astype(np.uint8) if suffix == ".png" else picture
        said = f"picture{suffix}: (cannot be written|what was written does not read back)"
        with pytest.raises(InputError, match=said):
            write_image(file, pixels)
    material = jaxvision.Lambert(np.linspace(0.1, 0.2, 500))
    with pytest.raises(
        InputError, match=r"matte\.toml: cannot be written: .*; choose another path"
    ):
        jaxvision.write_material(material, tmp_path / "matte.toml")
    assert not list(tmp_path.iterdir())


@full_disk()
def test_a_render_on_a_full_disk_keeps_its_tiles(tmp_path):
    """The message names the file, and the render continues when there is room again."""
    key = {"scene": "ball"}
    with PartialImage(tmp_path / "a.partial", key=key, values=100, fresh=True) as tiles:
        for number in range(2):
            tiles.append(np.full(100, number, np.float32))
        with pytest.raises(OSError, match=r"a\.partial"):
            tiles.append(np.full(100, 2, np.float32))
    with PartialImage(tmp_path / "a.partial", key=key, values=100, fresh=False) as again:
        assert again.done == 2
        np.testing.assert_array_equal(again.tile(1), 1)
    with pytest.raises(InputError, match=r"b\.partial: cannot be written"):
        PartialSum(tmp_path / "b.partial", key=key, shape=(500,), fresh=True).add(np.ones(500))
    assert not (tmp_path / "b.partial").exists()


@pytest.mark.parametrize("words", ["noise levels.csv --out TO", "noise GONE --out out"])
def test_a_folder_that_cannot_be_made_and_a_missing_input(tmp_path, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "levels.csv").write_text(TABLE)
    words = words.replace("TO", "levels.csv/inside").replace("GONE", "gone.csv")
    status, _, error = called(fitting.cli.app, *words.split())
    assert status == 2
    assert error.strip().split("\n")[-1].endswith(".")
    assert [file.name for file in tmp_path.iterdir()] == ["levels.csv"]
