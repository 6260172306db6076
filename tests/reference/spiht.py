"""Plain twin of the zerotree coder without contexts: sets as they are defined, decisions as a list.

Nodes are named by (component, level, kind, row, column); children are found by arithmetic on these, and sets
by going through all descendants.
"""

from collections.abc import Iterator

import numpy as np

Node = tuple[int, int, int, int, int]


class SpihtTwin:
    """Writes the decisions of whole-numbered pyramids."""

    def __init__(self, bands: dict[tuple[int, int, int], np.ndarray], num_planes: int) -> None:
        self.bands = bands
        self.num_planes = num_planes
        self.decisions: list[int] = []
        self.found: list[Node] = []
        self.pending: list[Node] = []
        self.sets: list[tuple[Node, bool]] = []

    def value(self, node: Node) -> int:
        return int(self.bands[node[:3]][node[3:]])

    def parent(self, node: Node) -> Node | None:
        component, level, kind, row, column = node
        above = self.bands.get((component, level + 1, kind))
        if kind == 0 or above is None or above.size == 0:
            return None
        return (
            component,
            level + 1,
            kind,
            min(row // 2, above.shape[0] - 1),
            min(column // 2, above.shape[1] - 1),
        )

    def children(self, node: Node) -> list[Node]:
        component, level, kind, *_ = node
        below = self.bands.get((component, level - 1, kind)) if kind else None
        if below is None:
            return []
        places = ((component, level - 1, kind, m, n) for m, n in np.ndindex(*below.shape))
        return [child for child in places if self.parent(child) == node]

    def descendants(self, node: Node) -> Iterator[Node]:
        for child in self.children(node):
            yield child
            yield from self.descendants(child)

    def deeper(self, node: Node) -> list[Node]:
        return [below for child in self.children(node) for below in self.descendants(child)]

    def any_significant(self, nodes: list[Node], plane: int) -> bool:
        return any(abs(self.value(node)) >> plane for node in nodes)

    def write(self) -> list[int]:
        """Return all decisions."""
        for band, values in self.bands.items():
            for place in np.ndindex(*values.shape):
                if self.parent((*band, *place)) is None:
                    self.pending.append((*band, *place))
        self.sets = [(node, False) for node in self.pending if self.children(node)]
        for plane in reversed(range(self.num_planes)):
            before = list(self.found)
            self.pending = [node for node in self.pending if not self.coefficient(node, plane)]
            self.set_pass(plane)
            self.decisions += [abs(self.value(node)) >> plane & 1 for node in before]
        return self.decisions

    def coefficient(self, node: Node, plane: int, certain: bool = False) -> bool:
        significant = bool(abs(self.value(node)) >> plane)
        if not certain:
            self.decisions.append(int(significant))
        if significant:
            self.decisions.append(self.sign_decision(node))
            self.found.append(node)
        return significant

    def sign_decision(self, node: Node) -> int:
        """Return whether a sign is opposite to that of the neighbours: beside, above and below, diagonal."""
        found, (m, n) = set(self.found), node[3:]

        def sign(a: int, b: int) -> int:
            other = (*node[:3], m + a, n + b)
            return int(np.sign(self.value(other))) if other in found else 0

        pairs = [((0, -1), (0, 1)), ((-1, 0), (1, 0)), ((-1, -1), (1, 1)), ((-1, 1), (1, -1))]
        sums = [sign(*a) + sign(*b) for a, b in pairs]
        if node[2] == 1:
            sums[:2] = sums[1::-1]
        expected = next((total for total in sums if total), 1)
        return int((self.value(node) < 0) != (expected < 0))

    def set_pass(self, plane: int) -> None:
        entries, self.sets, new = self.sets, [], []
        for node, deeper in entries:
            below = self.deeper(node) if deeper else list(self.descendants(node))
            self.decisions.append(int(self.any_significant(below, plane)))
            if not self.decisions[-1]:
                self.sets.append((node, deeper))
                continue
            stack = self.split(node, plane, new) if deeper else [node]
            while stack:
                stack += self.open(stack.pop(), plane, new)
        self.sets += new

    def open(self, node: Node, plane: int, new: list[tuple[Node, bool]]) -> list[Node]:
        children, deeper, found = self.children(node), self.deeper(node), False
        for child in children:
            certain = child == children[-1] and not found and not deeper
            if self.coefficient(child, plane, certain):
                found = True
            else:
                self.pending.append(child)
        if not deeper:
            return []
        if found:
            self.decisions.append(int(self.any_significant(deeper, plane)))
            if not self.decisions[-1]:
                new.append((node, True))
                return []
        return self.split(node, plane, new)

    def split(self, node: Node, plane: int, new: list[tuple[Node, bool]]) -> list[Node]:
        opened = []
        parents = [child for child in self.children(node) if self.children(child)]
        for child in parents:
            significant = self.any_significant(list(self.descendants(child)), plane)
            if child != parents[-1] or opened:
                self.decisions.append(int(significant))
            if significant:
                opened.append(child)
            else:
                new.append((child, False))
        return opened
