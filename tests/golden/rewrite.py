"""Write the golden figures anew and print what has moved: python tests/golden/rewrite.py [CASE ...].

Each case runs four times, once with the ranges as they are and then with all of them changed by some 1e-8 m: the
digits that agree are kept, with a margin. They survive a change of 1e-9 m, which is another last digit of one float32
in a hundred. Another version of Python may round a float64 in another way, which is a change of 1e-15 m.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))

from golden.cases import CASES  # noqa: E402
from golden.figures import Figures, figures, moved, read, surviving, write  # noqa: E402

SHIFTS_M = (1e-8, -1e-8, 2e-8)


def ran(name: str, shift_m: float = 0.0) -> Figures:
    """The figures of a case whose ranges are changed by `shift_m`."""
    with tempfile.TemporaryDirectory() as folder:
        CASES[name](Path(folder), shift_m)
        return figures(Path(folder) / "run")


def main() -> None:
    """Rewrite the named cases, or all."""
    for name in sys.argv[1:] or CASES:
        file, found, others = HERE / f"{name}.txt", ran(name), [ran(name, shift_m) for shift_m in SHIFTS_M]
        lost = {figure for other in others for figure in {*found} ^ {*other}}
        if lost:
            raise SystemExit(f"{name}: found {sorted(lost)} in some runs alone, allowed: in each")
        kept = {figure: surviving(line, [other[figure] for other in others]) for figure, line in found.items()}
        changes = moved(read(file), kept)
        write(file, kept)
        print(f"{name}: {len(changes)} of {len(kept)} figures moved", *changes, sep="\n  ")


if __name__ == "__main__":
    main()
