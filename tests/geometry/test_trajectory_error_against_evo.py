"""Our errors of trajectories beside those of evo, on the same definitions.

Our RPE goes from every pose to the first one at least a distance of true path later; evo takes the pose
nearest to that distance, or stretches that do not overlap. So evo's error is computed over our pairs, and
once over its own, where it comes close.
"""

import numpy as np
import pytest

from companion.geometry import rotation, trajectory_error
from companion.geometry.rotation import FloatArray

pytest.importorskip("evo")

from evo.core import metrics
from evo.core.trajectory import PoseTrajectory3D

Poses = tuple[FloatArray, FloatArray]


def truth() -> Poses:
    s = np.linspace(0.0, 30.0, 601)
    p = np.stack([s + np.sin(s), 3.0 * np.sin(0.3 * s), 0.5 * np.cos(s)], axis=1)
    return p, rotation.exp(np.stack([0.1 * np.sin(s), 0.05 * np.cos(s), 0.2 * s], axis=1))


def estimate() -> Poses:
    """The truth in another frame, with drift and noise in position and attitude."""
    p, q = truth()
    rng = np.random.default_rng(4)
    p = p * 1.004 + np.cumsum(rng.normal(0.0, 0.002, p.shape), axis=0) + rng.normal(0.0, 0.01, p.shape)
    q = rotation.multiply(q, rotation.exp(rng.normal(0.0, 0.01, p.shape)))
    q_other = rotation.exp(np.array([0.2, -0.1, 2.0]))
    return rotation.rotate(q_other, p) + np.array([5.0, 1.0, -2.0]), rotation.multiply(q_other, q)


def as_evo(poses: Poses) -> PoseTrajectory3D:
    p, q = poses
    return PoseTrajectory3D(positions_xyz=p, orientations_quat_wxyz=q, timestamps=np.arange(len(p)) * 0.1)


def rmse(metric: metrics.PE, reference: PoseTrajectory3D, estimated: PoseTrajectory3D) -> float:
    metric.process_data((reference, estimated))
    return float(metric.get_statistic(metrics.StatisticsType.rmse))


def test_absolute_errors_agree() -> None:
    ours = trajectory_error.absolute_error(*estimate(), *truth())
    reference, estimated = as_evo(truth()), as_evo(estimate())
    estimated.align(reference)
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    assert ours.rmse_m == pytest.approx(rmse(ape, reference, estimated), abs=1e-6)
    assert ours.median_m == pytest.approx(ape.get_statistic(metrics.StatisticsType.median), abs=1e-6)
    assert ours.max_m == pytest.approx(ape.get_statistic(metrics.StatisticsType.max), abs=1e-6)
    turned = metrics.APE(metrics.PoseRelation.rotation_angle_deg)
    assert ours.rotation_rmse_deg == pytest.approx(rmse(turned, reference, estimated), abs=1e-6)
    assert ours.rmse_m > 0.01


def test_the_alignment_is_the_same() -> None:
    reference, estimated = as_evo(truth()), as_evo(estimate())
    R, t, _ = estimated.align(reference)
    T = trajectory_error.align(estimate()[0], truth()[0])
    assert rotation.to_matrix(T.q) == pytest.approx(R, abs=1e-9)
    assert pytest.approx(t, abs=1e-9) == T.p


@pytest.mark.parametrize("distance_m", [2.0, 10.0])
def test_relative_errors_agree_over_the_same_pairs(
    distance_m: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    p_true, _ = truth()
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(p_true, axis=0), axis=1))])
    pairs = [
        (start, int(np.argmax(travelled >= travelled[start] + distance_m)))
        for start in range(len(p_true))
        if travelled[-1] >= travelled[start] + distance_m
    ]
    monkeypatch.setattr(metrics, "id_pairs_from_delta", lambda *_, **__: pairs)
    ours = trajectory_error.relative_error(*estimate(), *truth(), distance_m)
    moved = metrics.RPE(metrics.PoseRelation.translation_part, distance_m, metrics.Unit.meters)
    turned = metrics.RPE(metrics.PoseRelation.rotation_angle_deg, distance_m, metrics.Unit.meters)
    assert ours.rmse_m == pytest.approx(rmse(moved, as_evo(truth()), as_evo(estimate())), abs=1e-6)
    assert ours.max_m == pytest.approx(moved.get_statistic(metrics.StatisticsType.max), abs=1e-6)
    assert ours.rotation_rmse_deg == pytest.approx(
        rmse(turned, as_evo(truth()), as_evo(estimate())), abs=1e-6
    )


def test_relative_errors_are_close_to_evos_own_choice_of_pairs() -> None:
    ours = trajectory_error.relative_error(*estimate(), *truth(), 5.0)
    evos = metrics.RPE(
        metrics.PoseRelation.translation_part,
        5.0,
        metrics.Unit.meters,
        rel_delta_tol=0.1,
        all_pairs=True,
        pairs_from_reference=True,
    )
    assert ours.rmse_m == pytest.approx(rmse(evos, as_evo(truth()), as_evo(estimate())), rel=0.02)
