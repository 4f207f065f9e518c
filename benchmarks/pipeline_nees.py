"""Consistency of the whole pipeline: closed-loop tours with unknown association, with NEES, NIS and wrong matches.

    python benchmarks/pipeline_nees.py --seeds 15 --first-seed 1000

The NEES of the pose in world coordinates and of the right-invariant error are 3 if consistent, that of position 2, that
of heading 1: at every keyframe after its update, from the first full-rank covariance on. A wrong match is of another
wall or point than the landmark, by the walls that the observation's returns hit (`sixthsense.evaluation.matches`). A
spanning observation is fitted to several walls. An unexplained one is of nothing in the scene. Left out are those whose
fit does not distinguish the walls concerned. Discarded is the share of all observations that the gates dropped.
"""

from __future__ import annotations

import itertools

from harness import arguments, finish
from tours import add_tour_options, check_tour_options, rows, seeded, table, tour

from sixthsense.config.errors import InputError
from sixthsense.slam.estimators import ESTIMATORS


def main() -> None:
    parser = arguments(__doc__)
    add_tour_options(parser, seeds=50)
    parser.add_argument("--estimator", nargs="+", default=["isam2", "ekf-invariant"], choices=ESTIMATORS)
    parser.add_argument("--preset", default="default", choices=("default", "worn"))
    parser.add_argument("--scene", nargs="+", default=["apartment"], metavar="SCENE", help="shipped (apartment)")
    options = parser.parse_args()
    check_tour_options(parser, options)
    try:
        configs = [
            tour(scene, name, options.preset, options.max_time, options.config)
            for scene, name in itertools.product(options.scene, options.estimator)
        ]
    except InputError as error:
        parser.error(str(error))
    found = rows(seeded(configs, options), options.jobs, options.rows)
    finish(options, "pipeline_nees", table(found, options.scene, options.estimator), text=2)


if __name__ == "__main__":
    main()
