"""Links in a factor graph, with the places of their factors."""

from __future__ import annotations

from collections.abc import Collection, Sequence

LinkId = int


class LinkFactors:
    """Links by the place of their factors in the graph."""

    def __init__(self) -> None:
        self._places: dict[LinkId, int] = {}
        self._poses: dict[LinkId, tuple[int, int]] = {}
        self._of_pose: dict[int, set[LinkId]] = {}
        self._made = 0

    def add(self, poses: Sequence[tuple[int, int]], places: Sequence[int]) -> list[LinkId]:
        """Add links between `poses` whose factors have these places; their ids, which are never given again."""
        ids = list(range(self._made, self._made + len(places)))
        self._places.update(zip(ids, places, strict=True))
        self._poses.update(zip(ids, poses, strict=True))
        for i, ends in zip(ids, poses, strict=True):
            for pose in ends:
                self._of_pose.setdefault(pose, set()).add(i)
        self._made += len(places)
        return ids

    def of_poses(self, poses: Collection[int]) -> list[LinkId]:
        """The links of these poses, ascending."""
        return sorted(set().union(*(self._of_pose.get(pose, ()) for pose in poses)))

    def drop(self, ids: Collection[LinkId]) -> list[int]:
        """Remove links; the places of their factors, ascending. KeyError, before any is removed, for an unknown one."""
        places = sorted(self._places[i] for i in set(ids))
        for i in set(ids):
            del self._places[i]
            for pose in self._poses.pop(i):
                self._of_pose[pose].discard(i)
                if not self._of_pose[pose]:
                    del self._of_pose[pose]
        return places

    def renumber(self, before: Sequence[int], after: Sequence[int]) -> None:
        """Renumber the factors: those at the places `before` are now at `after`."""
        moved = dict(zip(before, after, strict=True))
        self._places = {i: moved[place] for i, place in self._places.items()}
