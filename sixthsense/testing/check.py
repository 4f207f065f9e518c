"""`check_estimator`: test an estimator against the laws of the contract."""

from __future__ import annotations

import traceback

from sixthsense.evaluation.tables import html_table
from sixthsense.slam.estimators import EstimatorFactory, register_estimator
from sixthsense.testing import contract, edges


class Verdicts(dict[str, str]):
    """The violation of each law, by the name of the law; empty if the law holds."""

    @property
    def kept(self) -> bool:
        """Whether all laws hold."""
        return not any(self.values())

    def __repr__(self) -> str:
        broken = [f"{law.replace('_', ' ')}: {violation}" for law, violation in self.items() if violation]
        if not broken:
            return f"keeps all {len(self)} laws"
        return "\n".join([f"breaks {len(broken)} of {len(self)} laws", *broken])

    def _repr_html_(self) -> str:
        rows = [[law.replace("_", " "), "broken" if found else "kept", found] for law, found in self.items()]
        return html_table(["law", "verdict", "violation"], rows)


def check_estimator(factory: EstimatorFactory, name: str = "") -> Verdicts:
    """Test an estimator against all laws of the `Estimator` contract, like the package's own tests.

    `factory` makes an estimator from the start, `T_world_robot`, and its covariance (3, 3), as for
    `ss.register_estimator`. It is registered under `name`, by default the name of the factory. Raises ValueError for
    the name of a built-in estimator and for an invalid name.
    """
    name = name or getattr(factory, "__name__", "")
    register_estimator(name, factory)
    verdicts = Verdicts()
    for law in (*contract.LAWS, *edges.LAWS):
        try:
            law.check(name)
        except Exception as error:  # raised by the law or by the estimator: the law is violated either way
            line = traceback.extract_tb(error.__traceback__)[-1]
            message = str(error).partition("\n")[0] or str(line.line)
            verdicts[law.name] = f"{type(error).__name__}: {message}"
        else:
            verdicts[law.name] = ""
    return verdicts
