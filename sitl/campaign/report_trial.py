"""One trial as a page: its paths between the obstacles, and the metrics over its time."""

import math
from pathlib import Path

from companion.logs.figure_page import FigureBox, page, write_whole
from companion.logs.metrics import DEFAULT_CAP_M, measure
from companion.logs.swarm_page import series_boxes
from companion.messages import FloatArray
from sitl.campaign.plots_trial import plan_view
from sitl.campaign.tables import failure_title
from sitl.campaign.tables_labels import method_title, world_title
from sitl.campaign.tables_rendering import Row, Table, html_table
from sitl.swarm.record import TrialRecord
from sitl.swarm.scene import SwarmScene
from sitl.swarm.settings import TerminationSettings


def write_trial_page(
    path: Path,
    record: TrialRecord,
    scene: SwarmScene,
    t: FloatArray,
    p_world: FloatArray,
    v_world: FloatArray,
    distances: FloatArray,
    *,
    termination: TerminationSettings | None = None,
    cap_m: float = DEFAULT_CAP_M,
) -> None:
    """Write the page of a trial; an old one is replaced.

    Args:
        path: of the page.
        record: what the trial came to.
        scene: where it was flown.
        t: (T,) s.
        p_world: (T, N, 3) positions, m; vehicle 0 is the leader.
        v_world: (T, N, 3) velocities, m/s.
        distances: (T, N) to the nearest surface, m; infinite where none is near.
        termination: what ended it.
        cap_m: obstacles farther than this do not count for MDO.

    Raises:
        LogError: if it cannot be written, the trial has less than two samples, or plotly is not installed.
    """
    radius_m = (termination or TerminationSettings()).vehicle_radius_m
    metrics = measure(t, p_world, v_world, distances, cap_m=cap_m)
    figure = plan_view(p_world, scene.world, scene.waypoints_world)
    boxes = [FigureBox("plan", "Paths", "Seen from above; the leader is black.", figure, wide=True)]
    boxes += series_boxes(metrics, (2.0 * radius_m, radius_m))
    title = f"{world_title(record.world)}, {method_title(record.method)}, trial {record.trial}"
    lead = f"{record.followers} followers, {record.fidelity}, seed {record.seed}, scene {record.scene_hash}."
    write_whole(path, page(title, lead, boxes, before=html_table(_table(record, cap_m))))


def _table(record: TrialRecord, cap_m: float) -> Table:
    concerned = ", ".join("leader" if number == 0 else str(number) for number in record.ended_by)
    values = (
        record.flock_radius_m,
        record.minimum_separation_m,
        record.alignment,
        record.obstacle_distance_m,
    )
    cells = (
        "success" if record.end == "success" else failure_title(record.end),
        concerned or "–",
        f"{record.t_end_s:.1f}",
        f"{record.mission_progress_percent:.1f}",
        *(f"{value:.2f}" if math.isfinite(value) else "–" for value in values),
    )
    return Table(
        name="trial",
        title="What it came to",
        names=("End", "By"),
        values=("At (s)", "MP (%)", "FR (m)", "MS (m)", "AL", "MDO (m)"),
        rows=(Row(cells),),
        notes=(f"MDO averages over the moments with a surface nearer than {cap_m:g} m to any UAV.",),
    )
