"""Who is to blame when a run fails: the part of a user's own that raised, or that returned what it must not."""

from __future__ import annotations

import inspect
import traceback
from types import TracebackType
from typing import Any

import numpy as np

from sixthsense.config import Config
from sixthsense.config.errors import InputError, PartError, reason_of
from sixthsense.config.parts import KINDS
from sixthsense.core.covariance import covariance_fault
from sixthsense.core.source import Tick
from sixthsense.slam.estimators import Estimator
from sixthsense.slam.result import Step


class OwnParts:
    """The parts of a run that are not shipped, entered as a context around each tick."""

    def __init__(self, config: Config, estimator: Estimator) -> None:
        """Watch the parts of a configuration; raises InputError for one that cannot be imported."""
        self._files: dict[str, str] = {}
        """by the file that has it, kind and name of each"""
        for parts in KINDS:
            name = getattr(config, parts.kind)
            if name not in parts.shipped:
                self._files |= dict.fromkeys(code_files(parts.load(name)), f"{parts.kind} {name}")
        self._estimator = None if config.estimator in KINDS[0].shipped else estimator
        self._name = f"{KINDS[0].kind} {config.estimator}"
        self._keyframe, self._first_ns, self._time_s = -1, -1, 0.0

    def at(self, tick: Tick) -> OwnParts:
        """The context of a tick."""
        self._first_ns = tick.stamp_ns if self._first_ns < 0 else self._first_ns
        self._time_s = 1e-9 * (tick.stamp_ns - self._first_ns)
        return self

    def took(self, step: Step) -> None:
        """Check what an estimator that is not shipped says at a keyframe; PartError if that is no estimate."""
        if step.keyframe is None:
            return
        self._keyframe = step.keyframe.index
        if self._estimator is not None and (fault := estimate_fault(self._estimator)):
            raise PartError(self._name, fault, self._when)

    @property
    def _when(self) -> str:
        return f"after keyframe {self._keyframe}, at {self._time_s:.2f} s"

    def __enter__(self) -> None:
        return None

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Raise PartError in place of an error that began in a part, or that follows from what one returned."""
        if isinstance(error, PartError) and not error.when:
            raise PartError(error.part, error.found, self._when) from error
        if not isinstance(error, Exception) or isinstance(error, InputError | PartError) or not self._files:
            return
        for frame in reversed(traceback.extract_tb(trace)):
            if (part := self._files.get(frame.filename)) is not None:
                found = f"{frame.name} raised {type(error).__name__} in line {frame.lineno} ({reason_of(error)})"
                raise PartError(part, found, self._when) from error
        if self._estimator is not None and (fault := estimate_fault(self._estimator)):
            raise PartError(self._name, fault, self._when) from error


def code_files(part: Any) -> set[str]:
    """Files, or cells of a notebook, that hold the code of a class or function."""
    part = inspect.unwrap(part)
    members = [inspect.unwrap(one) for one in vars(part).values() if callable(one)] if inspect.isclass(part) else [part]
    return {one.__code__.co_filename for one in members if hasattr(one, "__code__")}


def estimate_fault(estimator: Estimator) -> str:
    """What is wrong with what an estimator returns: shapes, numbers that are not finite, covariances; "" if nothing."""
    try:
        estimate = estimator.estimate()
        joint = np.asarray(estimator.joint_covariance(estimate.ids.tolist()))
        pose, rows = estimate.pose.array(), np.asarray(estimator.trajectory())
        n = len(estimate.ids)
        shapes = {
            "estimate().pose_cov": (np.shape(estimate.pose_cov), (3, 3)),
            "estimate().landmarks": (np.shape(estimate.landmarks), (n, 2)),
            "joint_covariance": (joint.shape, (3 + 2 * n, 3 + 2 * n)),
            "trajectory()": (rows.shape, (len(rows), 3)),
        }
    except Exception as error:
        return f"an estimate that cannot be read ({type(error).__name__}: {reason_of(error)})"
    for name, (found, allowed) in shapes.items():
        if found != allowed:
            return f"{name} has shape {found}, allowed {allowed}"
    numbers = {
        "estimate().pose": pose,
        "estimate().pose_cov": estimate.pose_cov,
        "estimate().landmarks": estimate.landmarks,
        "trajectory()": rows,
    }
    for name, values in numbers.items():
        if not np.isfinite(values).all():
            return f"{name} is not finite"
    fault = covariance_fault(joint, lowest=-1e-9)
    return f"joint_covariance has {fault}" if fault else ""
