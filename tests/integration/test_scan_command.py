"""`pretouch scan register` as a user calls it, on the files that other tools write."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from helpers.mesh_cases import blind_scans, mesh_target_of
from PIL import Image
from pretouch_simulation.objects import MAKERS
from pretouch_simulation.protocol import Case, make_case

from pretouch.cli import main
from pretouch.estimate import Estimate, Mode, from_prior
from pretouch.geometry import Array, Pose, vector_from_rotation
from pretouch.mesh_target import MeshTarget
from pretouch.prior import Prior
from pretouch.wire.json import estimate_from_json
from pretouch.wire.reader import Members


@dataclass(frozen=True)
class Files:
    """One case's files, and the options that belong to them."""

    case: Case
    mesh: MeshTarget
    folder: Path

    def scans(self, suffix: str, count: int = 4) -> list[str]:
        return [str(self.folder / f"scan{k}{suffix}") for k in range(count)]

    @property
    def table(self) -> list[str]:
        return ["--table", *map(str, self.mesh.table.normal), str(self.mesh.table.offset)]

    @property
    def viewpoint(self) -> list[str]:
        return ["--viewpoint", *map(str, self.case.base_T_camera.translation)]

    @property
    def pose(self) -> list[str]:
        pose = self.mesh.base_T_object
        return ["--object-pose", *map(str, [*pose.translation, *pose.quaternion])]


_PLY = """ply
format binary_little_endian 1.0
element vertex {n}
property double x
property double y
property double z
end_header
"""
_PCD = """VERSION 0.7
FIELDS x y z
SIZE 8 8 8
TYPE F F F
WIDTH {n}
HEIGHT 1
DATA binary
"""


def write_cloud(path: Path, points: Array) -> str:
    header = _PCD if path.suffix == ".pcd" else _PLY
    path.write_bytes(header.format(n=len(points)).encode() + np.asarray(points, dtype="<f8").tobytes())
    return str(path)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Files:
    folder = tmp_path_factory.mktemp("scans")
    case = make_case("drill", MAKERS["drill"](), 0)
    mesh = mesh_target_of(case)
    camera = {name: getattr(case.camera, name) for name in ("fx", "fy", "cx", "cy")}
    table = [*mesh.table.normal, mesh.table.offset]
    pose = case.base_T_camera.matrix
    np.savez(folder / "view.npz", depth=case.depth.metres, **camera, base_T_camera=pose, mask=case.mask, table=table)
    write_cloud(folder / "cloud.ply", case.cloud)
    write_cloud(folder / "cloud.pcd", case.cloud)
    np.savez(folder / "cloud.npz", points=case.cloud)
    trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(folder / "mesh.ply")
    for k, scan in enumerate(blind_scans(case)):
        np.savez(folder / f"scan{k}.npz", origins=scan.origins, directions=scan.directions, ranges=scan.ranges)
        write_cloud(folder / f"scan{k}.ply", scan.points())
    return Files(case, mesh, folder)


@dataclass(frozen=True)
class Done:
    code: int
    out: str
    err: str

    @property
    def document(self) -> Any:
        return json.loads(self.out)

    @property
    def estimate(self) -> Estimate:
        return estimate_from_json(Members(self.document, "estimate", None))


@pytest.fixture
def register(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Any:
    def run(*arguments: object) -> Done:
        monkeypatch.setattr(sys, "argv", ["pretouch", "scan", "register", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        captured = capsys.readouterr()
        return Done(int(ended.value.code or 0), captured.out, captured.err)

    return run


@pytest.mark.parametrize(
    ("target", "source", "options"),
    [
        ("view.npz", ".npz", []),
        ("view.npz", ".ply", []),
        ("cloud.ply", ".npz", ["table", "viewpoint"]),
        ("cloud.pcd", ".ply", ["table", "viewpoint"]),
        ("cloud.npz", ".npz", ["table", "viewpoint"]),
        ("mesh.ply", ".npz", ["table", "pose"]),
    ],
)
def test_every_form_of_a_target_finds_the_correction(
    register: Any, files: Files, target: str, source: str, options: list[str]
) -> None:
    given = [word for option in options for word in getattr(files, option)]
    done = register(files.folder / target, *files.scans(source), *given, "--json", "-")
    assert done.code == 0, done.err
    estimate = done.estimate
    assert files.case.error(Pose.identity()) > 0.018
    assert files.case.error(estimate.base_T_correction) < 0.005
    assert files.case.error(estimate.base_T_correction) < estimate.error_quantile < 0.012
    if "pose" in options:
        members = Members(done.document, "", None)
        found, truth = members.pose("base_T_object"), files.case.truth @ files.mesh.base_T_object
        assert np.linalg.norm(found.translation - truth.translation) < 0.006
        assert np.linalg.norm(vector_from_rotation(found.rotation @ truth.rotation.T)) < 0.05
    else:
        assert "base_T_object" not in done.document


def test_what_was_taken_for_granted_is_said_beside_the_document(register: Any, files: Files) -> None:
    done = register(files.folder / "cloud.ply", *files.scans(".ply"), "--json", "-")
    assert done.code == 0
    assert "the table is taken to be level at its lowest points, z = 0.01" in done.err
    assert "--viewpoint" in done.err
    assert files.case.error(done.estimate.base_T_correction) < files.case.error(Pose.identity()) / 2


def test_a_view_without_a_table_takes_it_at_the_objects_lowest_points(
    register: Any, files: Files, tmp_path: Path
) -> None:
    bare = changed(files, tmp_path, table=None)
    done = register(bare, *files.scans(".npz"), "--json", "-")
    assert done.code == 0, done.err
    assert "the table is taken to be level at its lowest points" in done.err
    assert files.case.error(done.estimate.base_T_correction) < files.case.error(Pose.identity()) / 2
    given = register(bare, *files.scans(".npz"), *files.table, "--json", "-")
    assert "taken to be" not in given.err
    assert given.document == register(files.folder / "view.npz", *files.scans(".npz"), "--json", "-").document


def test_a_document_goes_to_a_file_beside_the_table(register: Any, files: Files, tmp_path: Path) -> None:
    arguments = [files.folder / "view.npz", *files.scans(".npz", 1), "--json"]
    out = tmp_path / "new" / "estimate.json"
    done = register(*arguments, out)
    assert done.code == 0, done.err
    assert "expected error" in done.out
    assert json.loads(out.read_text()) == register(*arguments, "-").document


@pytest.mark.parametrize("option", ["--json", "--report"])
@pytest.mark.parametrize("place", ["/proc/a.png", "/dev/null/a.png", "."])
def test_a_place_that_cannot_be_written_is_refused_before_the_work(
    register: Any, tmp_path: Path, option: str, place: str
) -> None:
    done = register(tmp_path / "none.npz", tmp_path / "none.npz", option, place)
    assert done.code == 2
    assert f"{place} cannot be written" in done.err


def test_an_earlier_answer_is_a_prior(register: Any, files: Files, tmp_path: Path) -> None:
    view, (first, second, *_) = files.folder / "view.npz", files.scans(".npz")
    earlier, session = tmp_path / "earlier.json", tmp_path / "session.json"
    before = register(view, first, "--json", "-").document
    earlier.write_text(json.dumps(before))
    session.write_text(json.dumps({"id": "1", "estimate": before}))
    after = register(view, second, "--prior", earlier, "--json", "-")
    assert after.code == 0, after.err
    assert after.document == register(view, second, "--prior", session, "--json", "-").document
    assert after.estimate.expected_error < before["expected_error"]
    assert files.case.error(after.estimate.base_T_correction) < 0.006
    away = {**before, "centroid": [before["centroid"][0] + 1.0, *before["centroid"][1:]]}
    earlier.write_text(json.dumps(away))
    carried = register(view, second, "--prior", earlier, "--json", "-").estimate
    assert carried.expected_error > after.estimate.expected_error
    stds = tmp_path / "stds.json"
    stds.write_text('{"translation_std": 0.004, "rotation_std": 0.02}')
    options = ["--translation-std", "0.004", "--rotation-std", "0.02"]
    told = register(view, second, "--prior", stds, "--json", "-").document
    assert told == register(view, second, *options, "--json", "-").document


def test_a_full_disk_fails_in_two_lines(register: Any, files: Files) -> None:
    done = register(files.folder / "view.npz", *files.scans(".npz", 1), "--json", "/dev/full")
    assert done.code == 1
    assert "/dev/full cannot be written: No space left" in done.err
    assert Path("/dev/full").is_char_device()


def test_the_table_fits_sixty_columns(register: Any, files: Files, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    pose = ["--object-pose", *["0.123456", "0.2", "0.3", "0", "0", "0", "1"]]
    done = register(files.folder / "view.npz", *files.scans(".npz", 1), *pose)
    assert max(map(len, done.out.splitlines())) <= 60
    assert "…" not in done.out


def test_the_table_that_people_read_says_the_same(register: Any, files: Files) -> None:
    arguments = [files.folder / "view.npz", *files.scans(".npz", 1)]
    estimate = register(*arguments, "--json", "-").estimate
    text = " ".join(register(*arguments).out.split())
    assert f"{1000 * estimate.expected_error:.2f} mm" in text
    assert f"{1000 * estimate.error_quantile:.2f} mm" in text
    assert f"{estimate.inliers} of {estimate.samples} samples" in text
    assert estimate.unobservable
    for words in estimate.unobservable[0].text.split():
        assert words in text
    assert f"{estimate.fit:.3g}" in text


def test_other_places_a_bad_fit_and_samples_that_are_no_measurements_are_said(
    register: Any, files: Files, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = from_prior(Prior(), files.case.cloud)
    aside = Pose.of(np.eye(3), np.array([0.012, 0.0, -0.003]))
    answer = replace(
        before,
        modes=(Mode(before.base_T_correction, 0.8), Mode(aside, 0.2)),
        fit=0.00123,
        sensor_problem="All 90 ranges are 31 mm: the sensor is stuck.",
    )
    monkeypatch.setattr("pretouch_registrar.scan_command.Registrar.register", lambda *_: answer)
    arguments = [files.folder / "view.npz", *files.scans(".npz", 1)]
    done = register(*arguments)
    text = " ".join(done.out.split())
    assert "(12.00, 0.00, -3.00) mm, weight 0.20" in text
    assert "0.00123" in text
    assert "no measurements: All 90 ranges are 31 mm" in done.err
    document = register(*arguments, "--json", "-").document
    assert [mode["weight"] for mode in document["modes"]] == [0.8, 0.2]
    assert document["fit"] == 0.00123


def test_options_reach_the_engine(register: Any, files: Files) -> None:
    arguments = [files.folder / "view.npz", *files.scans(".npz"), "--json", "-"]
    plain = register(*arguments).estimate
    tight = register(*arguments, "--translation-std", 0.0001, "--rotation-std", 0.0001).estimate
    assert np.linalg.norm(tight.base_T_correction.apply(tight.centroid) - tight.centroid) < 0.001
    wide = register(*arguments, "--range-std", 0.01, "--beam-half-angle", 0.2).estimate
    assert wide.expected_error > plain.expected_error
    paper = register(*arguments, "--engine", "paper").estimate
    np.testing.assert_allclose(paper.covariance, Prior().covariance)


def test_a_report_shows_before_and_after(register: Any, files: Files, tmp_path: Path) -> None:
    picture = tmp_path / "report.png"
    arguments = [files.folder / "view.npz", *files.scans(".npz"), "--report"]
    assert register(*arguments, picture).code == 0
    with Image.open(picture) as image:
        pixels = np.asarray(image.convert("RGB")).astype(int)
    height = len(pixels)
    for half, colour in ((pixels[: height // 2], (0xD1, 0x49, 0x5B)), (pixels[height // 2 :], (0x00, 0x79, 0x8C))):
        assert (np.abs(half - colour).sum(axis=2) < 30).sum() > 200
    nowhere = register(*arguments, picture / "report.png")
    other = register(*arguments, tmp_path / "report.gif")
    assert [nowhere.code, other.code] == [2, 2]
    assert "cannot be written" in nowhere.err
    assert ".png" in other.err


def test_a_report_without_matplotlib_names_the_extra(
    register: Any, files: Files, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delitem(sys.modules, "pretouch_registrar.report_picture", raising=False)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    done = register(files.folder / "view.npz", *files.scans(".npz", 1), "--report", tmp_path / "a.png")
    assert done.code == 1
    assert "pip install 'pretouch[report]'" in done.err


def test_the_command_needs_neither_matplotlib_nor_open3d() -> None:
    code = "import sys, pretouch_registrar.scan_command; sys.exit(bool({'matplotlib', 'open3d'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], timeout=120, check=False).returncode == 0


def test_as_a_process_stdout_is_one_document(files: Files) -> None:
    command = [sys.executable, "-m", "pretouch", "scan", "register", str(files.folder / "cloud.ply")]
    done = subprocess.run(
        [*command, *files.scans(".ply", 1), "--json", "-"], capture_output=True, timeout=120, check=False, text=True
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["samples"] > 50
    assert "taken to be level" in done.stderr


@pytest.mark.parametrize("offset", [(0.3, 0.0, 0.0), (0.0, -0.3, 0.05), (0.0, 0.0, 0.35), (3.0, 0.0, 0.0)])
def test_scans_elsewhere_change_nothing_and_this_is_said(
    register: Any, files: Files, tmp_path: Path, offset: tuple[float, float, float]
) -> None:
    elsewhere = write_cloud(tmp_path / "far.ply", files.case.cloud + offset)
    done = register(files.folder / "view.npz", elsewhere, "--json", "-")
    before = from_prior(Prior(), files.case.cloud)
    assert done.code == 0
    assert done.estimate.expected_error > 0.8 * before.expected_error
    if not done.estimate.samples:
        assert "are both in base, in metres?" in done.err
        assert done.estimate.base_T_correction.is_close(Pose.identity())


def test_ten_million_points_are_thinned_and_it_is_said(register: Any, files: Files, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    cloud = files.case.cloud.astype(np.float32)
    many = tmp_path / "many.ply"
    points = cloud[rng.integers(len(cloud), size=10_000_000)]
    points += rng.uniform(-0.001, 0.001, points.shape).astype(np.float32)
    write_cloud(many, points)
    done = register(many, *files.scans(".npz"), *files.table, *files.viewpoint, "--json", "-")
    assert done.code == 0, done.err
    assert "10000000 points were thinned out to 1000000" in done.err
    assert files.case.error(done.estimate.base_T_correction) < files.case.error(Pose.identity()) / 2
    scan = tmp_path / "scan.ply"
    write_cloud(scan, points[:50_000])
    done = register(files.folder / "view.npz", scan, "--json", "-")
    assert "50000 samples were thinned out to 20000" in done.err


def changed(files: Files, tmp_path: Path, **changes: Any) -> Path:
    with np.load(files.folder / "view.npz") as arrays:
        written = {key: arrays[key] for key in arrays.files} | changes
    path = tmp_path / "changed.npz"
    np.savez(path, **{key: value for key, value in written.items() if value is not None})
    return path


BAD_VIEWS: dict[str, tuple[dict[str, Any], str]] = {
    "no mask": ({"mask": None}, "but no mask"),
    "an empty mask": ({"mask": np.zeros((480, 640))}, "0 pixels"),
    "a mask of another size": ({"mask": np.ones((2, 2))}, "The mask is [2, 2]"),
    "a table of three": ({"table": [0, 0, 1]}, "shape [3]"),
    "a long normal": ({"table": [0, 0, 2, 0]}, "norm 2"),
    "a crooked pose": ({"base_T_camera": np.ones((4, 4))}, "not a rigid"),
    "a NaN pose": ({"base_T_camera": np.full((4, 4), np.nan)}, "NaN"),
    "no focal length": ({"fx": 0.0}, "focal"),
    "a depth without its scale": ({"depth": np.ones((480, 640), dtype=np.uint16)}, "but no depth_scale"),
    "a depth in millimetres": ({"depth": np.full((480, 640), 8000.0)}, "as if it were in millimetres"),
    "a depth of 10 million pixels": ({"depth": np.ones((2500, 4000), dtype=np.float32)}, "10000000 pixels"),
    "a depth of words": ({"depth": np.array([["a"]]), "depth_scale": 1.0}, "<U1"),
}


@pytest.mark.parametrize("case", BAD_VIEWS)
def test_a_bad_view_is_refused_in_words(register: Any, files: Files, tmp_path: Path, case: str) -> None:
    changes, said = BAD_VIEWS[case]
    done = register(changed(files, tmp_path, **changes), *files.scans(".npz", 1))
    assert done.code == 2
    assert said in done.err
    assert "Traceback" not in done.err
    assert not done.out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["cloud.ply", "scan0.npz", "--viewpoint", "0.5", "0", "-3"], "not above the table"),
        (["cloud.ply", "scan0.npz", "--viewpoint", "0.5", "0", "0.06"], "among the target's points"),
        (["cloud.ply", "scan0.npz", "--viewpoint", "nan", "0", "1"], "NaN"),
        (["cloud.ply", "scan0.npz", "--table", "0", "0", "3", "0"], "norm 3"),
        (["cloud.ply", "scan0.npz", "--object-pose", "0", "0", "0", "0", "0", "0", "1"], "no triangles"),
        (["mesh.ply", "scan0.npz", "--object-pose", "0", "0", "0", "0", "0", "0", "2"], "norm 2"),
        (["view.npz", "scan0.npz", "--translation-std", "0"], "prior.translation_std is 0"),
        (["view.npz", "scan0.npz", "--translation-std", "nan"], "prior.translation_std"),
        (["view.npz", "scan0.npz", "--rotation-std", "-1"], "prior.rotation_std is -1"),
        (["view.npz", "scan0.npz", "--rotation-std", "inf"], "prior.rotation_std"),
        (["view.npz", "scan0.npz", "--prior", "none.json"], "none.json cannot be read: No such file"),
        (["view.npz", "scan0.npz", "--prior", "scan0.npz"], "scan0.npz is no JSON"),
        (["view.npz", "scan0.npz", "--prior", "list.json"], "list.json is no JSON object"),
        (["view.npz", "scan0.npz", "--prior", "other.json"], "other.json.mean is not a known member"),
        (["view.npz", "scan0.npz", "--prior", "skew.json"], "prior.covariance[0][5] is 1"),
        (["view.npz", "scan0.npz", "--range-std", "0"], "sensor.range_std"),
        (["view.npz", "view.npz"], "but no points"),
        (["scan0.npz", "scan0.npz"], "but no points"),
        (["view.npz", "damaged.npz"], "not a readable .npz"),
        (["view.npz", "pickled.npz"], "points holds Python objects"),
        (["view.npz", "uneven.npz"], "not equally many"),
        (["view.npz", "infinite.npz"], "infinite"),
        (["few.npz", "scan0.npz"], "3 distinct points"),
        (["same.npz", "scan0.npz"], "1 distinct points"),
        (["thousand.ply", "scan0.npz"], "m long, as if it were in millimetres"),
        (["view.npz", "thousand.ply"], "m long, as if it were in millimetres"),
        (["view.npz", "thousand.npz"], "m long, as if it were in millimetres"),
        (["millimetres.ply", "scan0.npz"], "90 m long, as if it were in millimetres"),
    ],
)
def test_bad_input_is_refused_in_words(register: Any, files: Files, arguments: list[str], said: str) -> None:
    folder = files.folder
    (folder / "damaged.npz").write_bytes((folder / "scan0.npz").read_bytes()[:200])
    np.savez(folder / "pickled.npz", points=np.array([{}, []], dtype=object))
    np.savez(folder / "uneven.npz", origins=np.zeros((3, 3)), directions=np.zeros((3, 3)), ranges=np.zeros(2))
    down = np.tile([0.0, 0.0, -1.0], (3, 1))
    np.savez(folder / "infinite.npz", origins=np.zeros((3, 3)), directions=down, ranges=np.full(3, np.inf))
    np.savez(folder / "few.npz", points=np.eye(3))
    np.savez(folder / "same.npz", points=np.ones((5000, 3)))
    write_cloud(folder / "thousand.ply", 1000 * files.case.cloud)
    with np.load(folder / "scan0.npz") as scan:
        beams = {name: scan[name] for name in scan.files}
    np.savez(folder / "thousand.npz", **beams | {name: 1000 * beams[name] for name in ("origins", "ranges")})
    (folder / "millimetres.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n90 0 0\n0 90 0\n3 0 1 2\n"
    )
    (folder / "list.json").write_text("[1]")
    (folder / "other.json").write_text('{"mean": 1}')
    pose = {"translation": [0, 0, 0], "rotation": [0, 0, 0, 1]}
    skew = [1e-4 * (i == j) + (i == 0 and j == 5) for i in range(6) for j in range(6)]
    (folder / "skew.json").write_text(json.dumps({"base_T_correction": pose, "covariance": skew}))
    done = register(*(folder / word if (folder / word).exists() else word for word in arguments))
    assert done.code == 2
    assert said in done.err
    assert "Traceback" not in done.err
