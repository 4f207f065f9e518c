"""An estimator of one's own, held to the contract."""

from __future__ import annotations

import html
import traceback

from sixthsense.slam.estimators import EstimatorFactory, register_estimator
from sixthsense.testing import contract, edges


class Verdicts(dict[str, str]):
    """By the name of each law what was found against it; empty where it is kept."""

    @property
    def kept(self) -> bool:
        """Whether all are."""
        return not any(self.values())

    def __repr__(self) -> str:
        broken = [f"{law.replace('_', ' ')}: {found}" for law, found in self.items() if found]
        if not broken:
            return f"keeps all {len(self)} laws"
        return "\n".join([f"breaks {len(broken)} of {len(self)} laws", *broken])

    def _repr_html_(self) -> str:
        rows = []
        for law, found in self.items():
            words = (html.escape(law.replace("_", " ")), "broken" if found else "kept", html.escape(found))
            rows.append(f"<tr>{''.join(f'<td>{word}</td>' for word in words)}</tr>")
        return f"<table>{''.join(rows)}</table>"


def check_estimator(factory: EstimatorFactory, name: str = "") -> Verdicts:
    """Hold an estimator to the laws of `Estimator`, as the package's own tests hold those that ship.

    `factory` makes one of the start, `T_world_robot`, and its covariance (3, 3), as for `ss.register_estimator`, which
    is what it becomes, by `name` or else its own. ValueError for a name that ships, or that is no name.
    """
    name = name or getattr(factory, "__name__", "")
    register_estimator(name, factory)
    verdicts = Verdicts()
    for law in (*contract.LAWS, *edges.LAWS):
        try:
            law.check(name)
        except Exception as error:  # of the law, or of the estimator: either way it does not keep it
            line = traceback.extract_tb(error.__traceback__)[-1]
            said = str(error).partition("\n")[0] or str(line.line)
            verdicts[law.name] = f"{type(error).__name__}: {said}"
        else:
            verdicts[law.name] = ""
    return verdicts
