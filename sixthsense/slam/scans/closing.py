"""Closing a loop: the links of a loop closure, how they are given to the estimator, and how they are taken back.

A loop that is off by metres cannot be closed with a loss that lets go of large residuals. The links of a new loop
closure are given as squares first, which distributes the error over the loop, and then with their loss. A loop closure
is undone if its own links contradict the graph then, or if it has made more other links contradict than it has.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from itertools import compress

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, wrap_angle
from sixthsense.slam.scans.graph import OLD_LOSS, ScanGraph
from sixthsense.slam.scans.links import Alignments
from sixthsense.slam.scans.poses import between
from sixthsense.slam.scans.uncertainty import UncertaintyGraph

_CONTRADICTION = 60.0  # squared Mahalanobis distance of a link that contradicts the graph, 3 degrees of freedom
_BACK_STEP, _BACK_GAP = 3, 12  # keyframes that are linked back, and without a link after which that ends
_ARCS = 2  # per keyframe: further links hardly make it more certain


@dataclass(slots=True)
class _Group:
    """A loop closure's links, and those that were made because of it."""

    ids: list[int] = field(default_factory=list)
    """of the estimator's links"""
    pairs: list[tuple[int, int]] = field(default_factory=list)
    """target and source of each"""
    measured: list[tuple[int, int, Array, Array]] = field(default_factory=list)
    """of each link: target, source, pose (3,) and information (3, 3)"""
    own: int = 0
    """how many of them, the first ones, are the loop closure's own"""


class Closings:
    """The loop closures so far. A link to an old keyframe belongs to the last of them, which made its pose known."""

    def __init__(self, graph: ScanGraph, uncertainty: UncertaintyGraph) -> None:
        self._graph, self._uncertainty = graph, uncertainty
        self._groups: dict[int, _Group] = {-1: _Group()}
        self._latest = -1
        self.accepted = 0
        """loop closures accepted so far"""
        self.undone = 0
        """loop closures taken back so far"""

    @property
    def links(self) -> list[tuple[int, int, Array, Array]]:
        """Links to old keyframes: target, source, pose (3,) of the source in the target's frame, information (3, 3)."""
        return [link for group in self._groups.values() for link in group.measured]

    @property
    def own_keys(self) -> set[int]:
        """Keyframes of the loop closures' own links."""
        return {k for group in self._groups.values() for pair in group.pairs[: group.own] for k in pair}

    def take_out(self, keys: Collection[int]) -> None:
        """Take in that keyframes have left the graph with their links, none of which were a loop closure's own."""
        gone = set(keys)
        for group in self._groups.values():
            lost = [not gone.isdisjoint(pair) for pair in group.pairs]
            self._graph.forget(list(compress(group.pairs, lost)))
            stays = [not is_lost for is_lost in lost]
            group.ids, group.pairs = list(compress(group.ids, stays)), list(compress(group.pairs, stays))
            group.measured = list(compress(group.measured, stays))

    def link(self, key: int) -> None:
        """Link a new keyframe to those before it, and to old ones around those that they are linked to."""
        self._keep(*self._graph.link(key, self._graph.near_linked(key)))

    def link_old(self, key: int, targets: NDArray[np.int64]) -> None:
        """Link a keyframe to old ones near it."""
        if len(targets):
            self._keep(*self._graph.link_old(key, targets))

    def link_back(self, key: int) -> None:
        """Link the keyframes before `key` to old ones around those that later ones are linked to, as far as they agree.

        While it was not clear where the robot was, they were not linked.
        """
        last, own = key, {source for _, source in self._groups[self._latest].pairs}
        for k in range(key - 1, self._graph.first, -1):
            if not self._graph.is_kept[k]:
                break
            if k in own:
                last = k
                continue
            if k in self._graph.old_links or last - k > _BACK_GAP:
                break
            if (key - k) % _BACK_STEP:
                continue
            made = self._graph.link_old(k, self._graph.near_linked_later(k))
            self._keep(*made)
            last = k if made.rows else last

    def close(self, links: list[tuple[Alignments, int]]) -> bool:
        """Close a loop with a loop closure's links, rows of alignments; whether the loop closure stands."""
        graph = self._graph
        self._latest = self.accepted
        self.accepted += 1
        broken = self._broken(self._latest)
        wide = graph.give(links, np.inf)
        ids = graph.give(links, OLD_LOSS)
        graph.estimator.unlink(wide)
        graph.forget([_pair(found, k) for found, k in links])
        graph.refresh()
        group = self._groups[self._latest] = _Group(own=len(links))
        self._keep(ids, links)
        while contradicted := [g for g in self._groups if self._contradiction(g) > _CONTRADICTION]:
            self._undo(max(contradicted, key=self._contradiction))
        if self._groups.get(self._latest) is group and self._broken(self._latest) - broken > len(links):
            self._undo(self._latest)
        return self._groups.get(self._latest) is group

    def _keep(self, ids: list[int], links: list[tuple[Alignments, int]]) -> None:
        """Remember links with the last loop closure, and add arcs for them."""
        group = self._groups[self._latest]
        group.ids += ids
        if not links:
            return
        arcs: dict[int, int] = {}
        covs = self._graph.covariances(links)
        for (found, k), cov, information in zip(links, covs, np.linalg.inv(covs), strict=True):
            target, source = _pair(found, k)
            group.pairs.append((target, source))
            group.measured.append((target, source, found.poses[k], information))
            arcs[source] = arcs.get(source, 0) + 1
            if arcs[source] <= _ARCS:
                position = float(np.linalg.eigvalsh(cov[:2, :2])[-1])
                self._uncertainty.add(target, source, position, float(cov[2, 2]), self._latest)

    def _contradiction(self, g: int) -> float:
        """Median squared Mahalanobis distance of a loop closure's own links from the estimate."""
        own = self._groups[g].measured[: self._groups[g].own]
        return float(np.median(self._squared(own))) if own else 0.0

    def _broken(self, newest: int) -> int:
        """How many links of all groups but the newest one contradict the estimate."""
        others = [link for g, group in self._groups.items() if g != newest for link in group.measured]
        return int(np.count_nonzero(self._squared(others) > _CONTRADICTION)) if others else 0

    def _squared(self, links: list[tuple[int, int, Array, Array]]) -> Array:
        """Squared Mahalanobis distances of links from the estimate."""
        targets, sources, measured, informations = (np.array(column) for column in zip(*links, strict=True))
        off = measured - between(self._graph.poses[targets], self._graph.poses[sources])
        off[:, 2] = wrap_angle(off[:, 2])
        return np.asarray(np.einsum("ni,nij,nj->n", off, informations, off))

    def _undo(self, g: int) -> None:
        """Take back a loop closure and all links that followed from it."""
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
