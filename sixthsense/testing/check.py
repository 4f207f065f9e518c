"""`check_estimator`: test an estimator against the laws of the contract."""

from __future__ import annotations

import traceback

import numpy as np

from sixthsense.core.landmarks import Kind, Observation
from sixthsense.evaluation.tables import html_table
from sixthsense.slam.estimators import EstimatorFactory, register_estimator
from sixthsense.testing import contract, edges, posterior, walls
from sixthsense.testing.estimation import make

LAWS = (*contract.LAWS, *edges.LAWS, *posterior.LAWS, *walls.LAWS)


class Verdicts(dict[str, str]):
    """The violation of each tested law, by the name of the law; empty if the law holds."""

    def __init__(self) -> None:
        super().__init__()
        self.skipped: dict[str, str] = {}
        """the laws that were not tested, with the reason: those of walls, if the estimator refuses walls"""

    @property
    def kept(self) -> bool:
        """Whether all tested laws hold."""
        return not any(self.values())

    def __repr__(self) -> str:
        broken = [f"{law.replace('_', ' ')}: {violation}" for law, violation in self.items() if violation]
        verdict = f"breaks {len(broken)} of {len(self)} laws" if broken else f"keeps all {len(self)} laws"
        if self.skipped:
            verdict += f"; {len(self.skipped)} laws of walls not tested: {next(iter(self.skipped.values()))}"
        return "\n".join([verdict, *broken])

    def _repr_html_(self) -> str:
        rows = [[law.replace("_", " "), "broken" if found else "kept", found] for law, found in self.items()]
        rows += [[law.replace("_", " "), "not tested", reason] for law, reason in self.skipped.items()]
        return html_table(["law", "verdict", "violation"], rows)


def check_estimator(factory: EstimatorFactory, name: str = "") -> Verdicts:
    """Test an estimator against all laws of the `Estimator` contract, like the package's own tests.

    `factory` makes an estimator from the start, `T_world_robot`, and its covariance (3, 3), as for
    `ss.register_estimator`. It is registered under `name`, by default the name of the factory. If the estimator raises
    NotImplementedError for the first observation of a wall, the laws of walls are skipped. Raises ValueError for the
    name of a built-in estimator and for an invalid name.
    """
    name = name or getattr(factory, "__name__", "")
    register_estimator(name, factory)
    verdicts, refusal = Verdicts(), _refusal_of_walls(name)
    for law in LAWS:
        if law.needs_walls and refusal:
            verdicts.skipped[law.name] = refusal
            continue
        try:
            law.check(name)
        except Exception as error:  # raised by the law or by the estimator: the law is violated either way
            line = traceback.extract_tb(error.__traceback__)[-1]
            message = str(error).partition("\n")[0] or str(line.line)
            verdicts[law.name] = f"{type(error).__name__}: {message}"
        else:
            verdicts[law.name] = ""
    return verdicts


def _refusal_of_walls(name: str) -> str:
    """The error with which an estimator refuses the first observation of a wall; empty if it does not."""
    try:
        make(name).update({0: Observation(Kind.WALL, np.array([0.5, -2.0]), 0.01 * np.eye(2), (-1.0, 1.0))})
    except NotImplementedError as error:
        return f"{type(error).__name__}: {error}"
    except Exception:  # the laws find it and name it
        return ""
    return ""
