"""The covariance of the pose that is published between keyframes."""

import numpy as np

import sixthsense as ss
from sixthsense.core.source import Tick
from sixthsense.live.publishing import pose_covariance
from sixthsense.record.trace import Trace


def test_the_covariance_is_that_of_the_keyframe_and_grows_until_the_next():
    seen: list[tuple[bool, np.ndarray, np.ndarray]] = []

    def look(tick: Tick, trace: Trace) -> None:
        if tick.scan is not None and trace.key_estimates:
            is_key = trace.key_stamps_ns[-1] == tick.stamp_ns
            seen.append((is_key, pose_covariance(trace), trace.key_estimates[-1].pose_cov))

    ss.run("rectangle", task="tour", max_time=10.0, on_tick=look, progress=False)
    assert any(is_key for is_key, _, _ in seen) and not all(is_key for is_key, _, _ in seen)
    for is_key, cov, key_cov in seen:
        if is_key:
            np.testing.assert_allclose(cov, key_cov, atol=1e-6)
        assert np.linalg.eigvalsh(cov).min() > -1e-12
        assert np.trace(cov) >= np.trace(key_cov) - 1e-9


def test_before_the_first_keyframe_nothing_is_known():
    assert not pose_covariance(Trace(ss.preset(), None, 0.2)).any()
