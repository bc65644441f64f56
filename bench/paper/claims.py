"""The paper's main claims: whether they hold in a run, and how much of that is chance."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from bench.paper.tables import Nested, Path, leaves, tables

CLOSE = 0.3
"""A number agrees with the reference if it differs by at most this fraction."""

CLOSE_MU = 0.05
"""A friction coefficient of Table 3 agrees with the reference if it differs by at most this."""

SURE = 0.95
"""A claim counts as reproduced if it holds in this fraction of the seeds: 19 of 20."""

SHARE = 0.9
"""The spread of a claim contains this share of what runs with as many other seeds would find."""

DRAWN = 200
"""How often the seeds are drawn again."""


RIGHT = {"table4": "ratio_center", "table5": "ratio_right"}
"""The hypothesis that is true, in each table of hypotheses."""


class Claim(NamedTuple):
    """A claim of the paper or of the reference.

    A claim about seeds says how often something held. Its spread is the exact (Clopper-Pearson) interval of the share of all
    seeds in which it holds. A claim about medians says how many of them are close enough. Its spread comes from drawing as many
    seeds again, with replacement (the bootstrap): the count lies within it in 90 % of the draws.
    """

    text: str
    asked: int | None  # None: nothing was asked
    held: int
    of: int
    spread: tuple[float, float]  # about seeds: shares in [0, 1]; about medians: counts
    about_seeds: bool

    @property
    def reproduced(self) -> bool:
        """Whether as many hold as were asked; if nothing was asked, whether all do."""
        return self.held >= (self.of if self.asked is None else self.asked)


def claims(seeds: Sequence[Mapping[str, Any]]) -> list[Claim]:
    """The claims, from the numbers of each seed (see `tables.tables`); the worst case of each claim about seeds counts."""
    rng = np.random.default_rng(0)
    medians = [{key: one[key] for key in ("table3", "table4", "table5")} for one in seeds]
    again = [tables([medians[index] for index in rng.integers(len(seeds), size=len(seeds))]) for _ in range(DRAWN)]
    found = tables(seeds)

    def worst(text: str, held: str, keys: Iterable[str]) -> Claim:
        asked = (leaf for path, leaf in leaves({key: found[key] for key in keys}) if path[-1] == held and "grid_4" not in path)
        leaf = min(asked, key=lambda one: one["held"] / one["of"])
        low, high = map(float, stats.binomtest(leaf["held"], leaf["of"]).proportion_ci(SHARE, "exact"))
        return Claim(text, int(np.ceil(SURE * leaf["of"])), leaf["held"], leaf["of"], (low, high), True)

    def near(text: str, asked: Callable[[Path], bool], known: str = "reference") -> Claim:
        all_close = _close(found, asked, known)
        counts = [sum(_close(draw, asked, known)) for draw in again]
        low, high = np.quantile(counts, ((1 - SHARE) / 2, (1 + SHARE) / 2), method="inverted_cdf").tolist()
        of = len(all_close)
        return Claim(text, of if known == "reference" else None, sum(all_close), of, (low, high), False)

    return [
        worst("the right one of three look-alikes (Tables 4 and 5, each grid of 9 points and more)", "correct", RIGHT),
        near(f"ratios of Tables 4 and 5 within {100 * CLOSE:.0f} % of the reference", _ratio),
        near(f"the same within {100 * CLOSE:.0f} % of the paper", _ratio, "paper"),
        worst("the four feet found among 15 points (Figure 5, each object)", "corners_are_top_four", ("figure5",)),
        worst("the true orientation (Figures 9 and 10, each half-width)", "correct", ("figure9", "figure10")),
        near(f"mu_c of wood_rect4 and the flat objects within {CLOSE_MU} of the reference (Table 3)", _friction),
    ]


def agrees(path: Path, leaf: Nested, known: str = "reference") -> bool | None:
    """Whether a number of tables.json is close to the reference or the paper, or holds often enough; None if that is unknown.

    Args:
        path: the keys that lead to it; in Table 3 `CLOSE_MU` is close, anywhere else `CLOSE`.
        leaf: the number.
        known: `reference` or `paper`.
    """
    if "held" in leaf:
        return bool(leaf["held"] >= SURE * leaf["of"])
    if known not in leaf:
        return None
    allowed = CLOSE_MU if path[0] == "table3" else CLOSE * abs(leaf[known])
    return bool(abs(leaf["median"] - leaf[known]) <= allowed)


def _close(summary: Nested, asked: Callable[[Path], bool], known: str = "reference") -> list[bool]:
    """Which numbers that are asked for are close, of those that the reference or the paper gives."""
    return [bool(agrees(path, leaf, known)) for path, leaf in leaves(summary) if known in leaf and asked(path)]


def _ratio(path: Path) -> bool:
    """Those of the wrong hypotheses of Tables 4 and 5, on grids of 9 points and more."""
    return path[0] in RIGHT and path[1] != "grid_4" and path[2].startswith("ratio") and path[2] != RIGHT[path[0]]


def _friction(path: Path) -> bool:
    """mu_c of the flat objects and wood_rect4, without the bad push."""
    return path[0] == "table3" and path[1] in ("delrin_rect_center", "delrin_rect_right", "wood_rect4")
