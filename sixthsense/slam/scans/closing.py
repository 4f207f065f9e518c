"""Closing a loop: the links of a revisit, how they are given to the estimator, and how they are taken back.

A loop that is off by metres cannot be closed with a loss that lets go of large residuals. The links of a new revisit
are given as squares first, which distributes the error over the loop, and then with their loss.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array
from sixthsense.slam.scans.graph import OLD_LOSS, ScanGraph
from sixthsense.slam.scans.links import Alignments
from sixthsense.slam.scans.poses import between
from sixthsense.slam.scans.uncertainty import UncertaintyGraph

_CONTRADICTION = 60.0  # median squared Mahalanobis distance of a revisit's links, 3 degrees of freedom
_ARCS = 2  # per key scan: further links hardly make it more certain


@dataclass(slots=True)
class _Group:
    """A revisit's links, and those that were made because of it."""

    ids: list[int] = field(default_factory=list)
    """of the estimator's links"""
    pairs: list[tuple[int, int]] = field(default_factory=list)
    """target and source of each"""
    targets: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    """of the revisit's own links, as `sources`, `poses` and `informations`"""
    sources: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    poses: Array = field(default_factory=lambda: np.zeros((0, 3)))
    informations: Array = field(default_factory=lambda: np.zeros((0, 3, 3)))


class Closings:
    """The revisits so far. Links to old key scans belong to the last revisit before them: it made their poses known."""

    def __init__(self, graph: ScanGraph, uncertainty: UncertaintyGraph) -> None:
        self._graph, self._uncertainty = graph, uncertainty
        self._groups: dict[int, _Group] = {-1: _Group()}
        self._latest = -1
        self.accepted = 0
        """revisits accepted so far"""
        self.undone = 0
        """revisits taken back so far"""

    def link(self, key: int) -> None:
        """Link a new key scan to those before it, and to old ones around those that they are linked to."""
        self._keep(*self._graph.link(key, self._graph.near_linked(key)))

    def link_old(self, key: int, targets: NDArray[np.int64]) -> None:
        """Link a key scan to old ones near it."""
        if len(targets):
            self._keep(*self._graph.link_old(key, targets))

    def close(self, links: list[tuple[Alignments, int]]) -> bool:
        """Close a loop with a revisit's links, rows of alignments; whether the revisit stands."""
        graph = self._graph
        self._latest = self.accepted
        self.accepted += 1
        wide = graph.give(links, np.inf)
        ids = graph.give(links, OLD_LOSS)
        graph.estimator.unlink(wide)
        graph.forget([_pair(found, k) for found, k in links])
        graph.refresh()
        group = self._groups[self._latest] = _Group(
            targets=np.array([found.targets[k] for found, k in links]),
            sources=np.array([found.sources[k] for found, k in links]),
            poses=np.array([found.poses[k] for found, k in links]),
            informations=np.array([np.linalg.inv(graph.covariance(found, k)) for found, k in links]),
        )
        self._keep(ids, links)
        while contradicted := [g for g in self._groups if self._contradiction(g) > _CONTRADICTION]:
            self._undo(max(contradicted, key=self._contradiction))
        return self._groups.get(self._latest) is group

    def _keep(self, ids: list[int], links: list[tuple[Alignments, int]]) -> None:
        """Remember links with the last revisit, and add arcs for them."""
        group = self._groups[self._latest]
        group.ids += ids
        arcs: dict[int, int] = {}
        for found, k in links:
            target, source = _pair(found, k)
            group.pairs.append((target, source))
            arcs[source] = arcs.get(source, 0) + 1
            if arcs[source] <= _ARCS:
                cov = self._graph.covariance(found, k)
                position = float(np.linalg.eigvalsh(cov[:2, :2])[-1])
                self._uncertainty.add(target, source, position, float(cov[2, 2]), self._latest)

    def _contradiction(self, g: int) -> float:
        """Median squared Mahalanobis distance of a revisit's own links from the estimate."""
        group, poses = self._groups[g], self._graph.poses
        if not len(group.targets):
            return 0.0
        off = group.poses - between(poses[group.targets], poses[group.sources])
        off[:, 2] = (off[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
        return float(np.median(np.einsum("ni,nij,nj->n", off, group.informations, off)))

    def _undo(self, g: int) -> None:
        """Take back a revisit and all links that followed from it."""
        group = self._groups.pop(g)
        self._graph.estimator.unlink(group.ids)
        self._graph.forget(group.pairs)
        self._graph.refresh()
        self._uncertainty.remove([g])
        self.undone += 1
        if g == self._latest:
            self._latest = max(self._groups)


def _pair(found: Alignments, k: int) -> tuple[int, int]:
    return int(found.targets[k]), int(found.sources[k])
