"""A session that asks for proposer `narf`, from the depth image to its first scan."""

from dataclasses import replace
from pathlib import Path

from helpers.made_frame import write_mesh
from pretouch_registrar.engines import Engine
from pretouch_registrar.registration import Registrar
from pretouch_simulation.evaluation import run_task
from pretouch_simulation.evaluation_protocol import Protocol, loop_of, request_of
from pretouch_simulation.evaluation_tasks import MeshTask
from pretouch_simulation.finger import FingerModel
from pretouch_simulation.objects import box, mug
from pretouch_simulation.protocol import make_case

from pretouch.session import Planner, Proposer, State

PROTOCOL = Protocol(1, Proposer.NARF, Engine.POSTERIOR, Planner.INFORMATION, FingerModel.IDEAL, seed=0)


async def test_a_session_on_narf_plans_a_scan_on_each_regions_terms() -> None:
    case = make_case("mug", mug(), 0)
    record = await loop_of(PROTOCOL, Registrar()).open("mug", 0.0, request_of(case, PROTOCOL), case.depth, case.mask)
    assert record.state is State.AWAITING_SCAN
    assert record.proposer is Proposer.NARF
    assert 3 <= len(record.regions) <= 12
    for region in record.regions:
        assert case.mask[int(region.rectangle.y), int(region.rectangle.x)]


async def test_a_flat_card_has_no_keypoint_and_is_scanned_straight_across() -> None:
    case = make_case("card", box(0.085, 0.054, 0.005), 0)
    record = await loop_of(PROTOCOL, Registrar()).open("card", 0.0, request_of(case, PROTOCOL), case.depth, case.mask)
    assert record.regions == ()
    assert record.next_scan is not None
    assert record.next_scan.path_id.startswith("line-")
    assert record.next_scan.region_id is None


def test_evaluation_rows_name_the_proposer(tmp_path: Path) -> None:
    write_mesh(tmp_path / "mug.obj", mug())
    (run,) = run_task(MeshTask(tmp_path / "mug.obj", 0), [replace(PROTOCOL, scans=3)])
    assert [row.proposer for row in run.rows] == 3 * ["narf"]
    assert run.rows[-1].error < 0.5 * run.rows[-1].initial_error
