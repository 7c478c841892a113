"""Tests studies of many folders: one table, outliers, drift, and continuation after an
interrupt."""

import datetime
import json
import shutil
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.stats
import tomli_w
import xarray as xr
from commands import called
from studies import write_camera

from fitting import folders
from fitting.cli import app
from fitting.inference.estimates import Estimate
from fitting.report.section import Section
from fitting.study.compare import Compared, compared, drifts
from fitting.study.outcomes import Outcome, Settings, digest_of
from fitting.study.page import _unlike
from fitting.study.run import study
from fitting.study.table import table
from jaxvision.errors import InputError


def outcome(name, value, error=0.1, *, temperature=None, date="", channel=""):
    estimate = Estimate(
        "read_noise",
        "sigma_d",
        "e-",
        value,
        error,
        (value - error, value + error),
        (value - 2 * error, value + 2 * error),
        method="likelihood",
        group=channel,
    )
    return Outcome(name, (estimate,), ("A finding.",), "", date, temperature)


def test_the_table_has_values_intervals_and_failures():
    found = table([outcome("a", 3.0), Outcome("b", failed="no flats"), outcome("c", 4.0)])
    assert found["value"].dims == ("camera", "channel", "quantity")
    one = found.sel(quantity="read noise (likelihood)", channel="")
    np.testing.assert_array_equal(one["value"], [3.0, np.nan, 4.0])
    np.testing.assert_allclose(one["low_95"], [2.8, np.nan, 3.8])
    assert list(found["failed"].values) == ["", "no flats", ""]
    assert found["unit"].item() == "e-"


def test_the_scatter_of_equal_errors_is_the_variance_beyond_them():
    """DerSimonian and Laird's estimate is then s^2 - error^2 in closed form."""
    rng = np.random.default_rng(0)
    values = 5 + 0.5 * rng.standard_normal(12)
    (one,) = compared(table([outcome(f"c{n}", v, 0.2) for n, v in enumerate(values)]))
    np.testing.assert_allclose(one.scatter**2, np.var(values, ddof=1) - 0.2**2, rtol=1e-12)
    np.testing.assert_allclose(one.median, np.median(values))
    assert one.differ
    alike = 5 + 0.2 * rng.standard_normal(12)
    (same,) = compared(table([outcome(f"c{n}", v, 0.2) for n, v in enumerate(alike)]))
    assert not same.differ


def test_a_camera_unlike_the_others_is_named_and_like_ones_seldom_are():
    rng = np.random.default_rng(1)
    names, called_out = [f"c{n}" for n in range(20)], 0
    for _ in range(200):
        values = rng.standard_normal(20)
        (one,) = compared(table([outcome(n, v, 0.5) for n, v in zip(names, values, strict=True)]))
        called_out += bool(one.outliers)
    assert called_out < 200 * 0.1  # a median of 20 absolute deviations is itself uncertain
    values[7] += 9
    (one,) = compared(table([outcome(n, v, 0.5) for n, v in zip(names, values, strict=True)]))
    assert one.outliers == ("c7",)
    few = compared(table([outcome(n, v) for n, v in zip(names[:4], (1, 1, 1, 9), strict=True)]))
    assert few[0].outliers == ()


def test_one_outlier_does_not_decide_how_the_others_differ():
    values = 5 + 0.2 * np.random.default_rng(3).standard_normal(12)
    names = [f"c{n}" for n in range(12)]
    values[4] = 50.0
    (one,) = compared(table([outcome(n, v, 0.2) for n, v in zip(names, values, strict=True)]))
    assert (one.outliers, one.values) == (("c4",), (50.0,))
    others = np.delete(values, 4)
    np.testing.assert_allclose(one.scatter**2, np.var(others, ddof=1) - 0.2**2, rtol=1e-12)
    assert not one.differ


def test_an_outlying_camera_is_described_in_few_words():
    one = Compared("gain", "", "DN/e-", 0.25, 0.0, False, ("c4",), (0.5,))
    several = [replace(one, quantity=f"q{i}", values=(0.5 + i / 100,)) for i in range(8)]
    said = _unlike([one, *several])["c4"]
    assert said.startswith("q7 0.57 DN/e- (median 0.25); q6")
    assert said.endswith("; 6 more quantities, below")


def test_drift_is_the_regression_line_if_it_is_significant():
    rng = np.random.default_rng(2)
    kelvin = 290 + np.arange(9.0)
    values = 3 + 0.2 * kelvin + 0.05 * rng.standard_normal(9)
    cameras = [
        outcome(f"c{n}", v, temperature=k)
        for n, (k, v) in enumerate(zip(kelvin, values, strict=True))
    ]
    (line,) = drifts(table([*cameras, outcome("without", 60.0)]))
    expected = scipy.stats.linregress(kelvin, values)
    np.testing.assert_allclose(
        [line.slope, line.standard_error], [expected.slope, expected.stderr], rtol=1e-9
    )
    assert line.unit == "e- / K"
    dated = [outcome(f"c{n}", v, date=f"202{n}-01-01") for n, v in enumerate(rng.random(9))]
    assert drifts(table(dated)) == ()


@pytest.fixture
def cameras(tmp_path, monkeypatch):
    """Return three folders and a calibration that counts its calls."""
    asked = []

    def calibrated(path, step, draws):
        asked.append(path.name)
        folders.read_rig(path, "photon transfer")
        if path.name == "b" and (path / "note").exists():
            raise InputError(f"{path}: too dark")
        with step("fitting"):
            value = float(len((path / "flat_0_0.png").read_bytes()))
        estimate = Estimate("size", "s", "1", value, 1.0, (value, value), (value, value))
        return [Section("noise", "Noise", (estimate,), ("Read.",))], {}

    monkeypatch.setattr(folders, "noise", calibrated)
    paths = [write_camera(tmp_path / n, seed=i, levels=2, side=4) for i, n in enumerate("abc")]
    return asked, paths, tmp_path / "out"


def test_folders_of_the_same_images_are_one_camera(cameras):
    """The folders are the same camera, whatever else their rigs state, unless the rigs use other
    regions of the images."""
    asked, paths, out = cameras
    for name, region in (("d", None), ("e", [0, 0, 2, 4])):
        folder = shutil.copytree(paths[0], out.parent / name)
        rig = tomllib.loads((folder / "rig.toml").read_text())
        rig["camera"] |= {"temperature": 293.0} | ({"region": region} if region else {})
        (folder / "rig.toml").write_text(tomli_w.dumps(rig))
    every = [*paths, out.parent / "d", out.parent / "e"]
    found = study(every, out, Settings("noise", reports=False))
    failed = {one.camera: one.failed for one in found.outcomes if one.failed}
    assert list(failed) == ["d"]
    assert failed["d"].startswith("8 of its 8 images are those of a, so that the two are one")
    assert "d" not in asked


@pytest.mark.slow
def test_a_study_continues_and_repeats_only_failures(cameras):
    asked, paths, out = cameras
    (paths[1] / "note").write_text("dark")
    seen = []
    found = study(paths, out, Settings("noise"), progress=lambda *n: seen.append(n))
    assert [one.failed for one in found.outcomes] == ["", f"{paths[1]}: too dark", ""]
    assert seen == [(0, 3), (1, 3), (2, 3), (3, 3)]
    with xr.open_dataset(out / "study.nc") as kept:
        xr.testing.assert_equal(kept.load(), found.found)
    page = (out / "study.html").read_text()
    assert 'href="a/report.html"' in page
    assert "not calibrated" in page
    assert (out / "a" / "report.html").exists()
    asked.clear()
    (paths[1] / "note").unlink()
    again = study(paths, out, Settings("noise"))
    assert asked == ["b"]
    assert not any(one.failed for one in again.outcomes)
    assert again.outcomes[0] == found.outcomes[0]
    asked.clear()
    study(paths, tmp := out.parent / "numbers", Settings("noise", reports=False))
    assert not (tmp / "a" / "report.html").exists()
    assert json.loads((tmp / "a" / "results.json").read_text())["sections"][0]["estimates"]
    assert 'href="a/results.json"' in (tmp / "study.html").read_text()
    asked.clear()
    study(paths, out, Settings("noise", seed=1))
    assert asked == ["a", "b", "c"]
    image = paths[2] / "flat_0_1.png"
    image.write_bytes(image.read_bytes() + b" ")
    asked.clear()
    study(paths, out, Settings("noise", seed=1))
    assert asked == ["c"]


def test_data_other_than_those_of_the_study_are_refused(cameras, monkeypatch):
    _, paths, out = cameras
    monkeypatch.setattr("fitting.study.run.digest_of", lambda path: "seen elsewhere")
    with pytest.raises(InputError, match="this worker sees other files"):
        study(paths, out, Settings("noise"))


def test_images_of_one_size_and_other_content_are_other_data(cameras):
    _, paths, _ = cameras
    seen = digest_of(paths[0])
    image = paths[0] / "flat_0_1.png"
    content = bytearray(image.read_bytes() + bytes(300_000))
    image.write_bytes(content)
    longer = digest_of(paths[0])
    for place in (0, len(content) // 2, len(content) - 1):
        changed = content.copy()
        changed[place] ^= 1
        image.write_bytes(changed)
        assert digest_of(paths[0]) != longer
    image.write_bytes(content)
    assert digest_of(paths[0]) == longer != seen


def test_a_report_that_cannot_be_written_fails_for_its_folder_only(cameras):
    asked, paths, out = cameras
    out.mkdir()
    (out / "b").write_text("in the way")
    found = study(paths, out, Settings("noise", reports=False))
    assert [bool(one.failed) for one in found.outcomes] == [False, True, False]
    assert str(out / "b") in found.outcomes[1].failed
    (out / "b").unlink()
    asked.clear()
    assert not study(paths, out, Settings("noise", reports=False)).outcomes[1].failed
    assert asked == ["b"]


@pytest.mark.parametrize("damage", [lambda kept: kept.pop("outcome"), lambda kept: kept.clear()])
def test_a_damaged_outcome_is_no_outcome(cameras, damage):
    asked, paths, out = cameras
    settings = Settings("noise", reports=False)
    first = study(paths[:1], out, settings)
    kept = json.loads((out / "a" / "outcome.json").read_text())
    damage(kept)
    (out / "a" / "outcome.json").write_text(json.dumps(kept))
    assert study(paths[:1], out, settings).outcomes == first.outcomes
    assert asked == ["a", "a"]


def test_links_to_folders_of_any_name(cameras):
    _, paths, out = cameras
    odd = paths[0].rename(paths[0].with_name("a#1 100%41?"))
    study([odd], out, Settings("noise", reports=False))
    assert 'href="a%231%20100%2541%3F/results.json"' in (out / "study.html").read_text()


def test_the_command_names_what_failed_and_its_status_says_so(cameras):
    _, paths, out = cameras
    (paths[0] / "rig.toml").unlink()
    status, said, complained = called(app, "study", "noise", *paths, "--out", out)
    assert status == 3
    assert "Calibrated: 2 of 3 folders" in said
    assert "a: not calibrated:" in complained
    assert "no such rig file" in complained
    assert json.loads((out / "b" / "outcome.json").read_text())["outcome"]["camera"] == "b"
    status, _, complained = called(app, "study", "noise", paths[1], paths[1], "--out", out)
    assert status == 2
    assert "two folders have this name" in complained


def test_dates_and_temperatures_come_from_the_rig(tmp_path, cameras):
    _, _, out = cameras
    day = datetime.date(2026, 3, 1)
    path = write_camera(tmp_path / "d", seed=1, levels=2, side=4, date=day, temperature=293.0)
    (one,) = study([path], out, Settings("noise")).outcomes
    assert (one.date, one.temperature) == ("2026-03-01", 293.0)


@pytest.mark.slow
def test_simulated_values_are_recovered_and_the_outlying_camera_is_named(tmp_path):
    """Five of six cameras have equal gain, and the read noise grows by .3 electrons per kelvin."""
    paths = [
        write_camera(
            tmp_path / f"cam{n}",
            seed=n,
            gain=0.32 if n == 3 else 0.25,
            read_noise=3 + 0.3 * n,
            temperature=293.0 + n,
        )
        for n in range(7)
    ]
    found = study([Path(path) for path in paths], tmp_path / "out", Settings("noise"))
    odd = {one.quantity: one.outliers for one in found.quantities if one.outliers}
    assert odd["system gain (likelihood)"] == ("cam3",)
    slopes = {one.quantity: one for one in found.drifts}
    line = slopes["read noise (likelihood)"]
    assert abs(line.slope - 0.3) < 4 * line.standard_error
