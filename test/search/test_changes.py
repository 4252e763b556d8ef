# SPDX-License-Identifier: Apache-2.0
"""Changes from one side to the other, beside what the model lacks on both."""

from dataclasses import replace

import numpy as np
import pytest

from ros2_ident.search.changes import (
    Changes,
    evidence_of,
    Logs,
    shown_from,
    weigh_changes,
)
from ros2_ident.search.evidence import price_of
from ros2_ident.search.noise import Run

# Rows of a log, and columns of everything that may change.
ROWS, COLUMNS = 600, 12


def compared(
    rng: np.random.Generator,
    logs: int,
    shift: float,
    scatter: float = 0.0,
    *,
    paired: bool = False,
    before: int | None = None,
    parts: float = 0.0,
    kept: tuple[int, ...] = (),
    once: int | None = None,
    loose: float = 0.0,
    lacks: float = 1.0,
) -> Changes:
    """Return what logs of two sides say, of which the column 7 is more by `shift` after.

    By `scatter` it differs from log to log, by `parts` between the quarters of one. The column
    `once` does the same in the first log of each side, and nothing in the others. By `loose`
    every column differs from log to log; `lacks` of each are there on both sides.
    """
    before = logs if before is None else before
    count = logs + before
    after = np.arange(count) >= before
    time = np.linspace(0.0, 1.0, ROWS)[:, None]
    rate, phase = rng.uniform(5.0, 60.0, COLUMNS), rng.uniform(0.0, 6.28, (count, 1, COLUMNS))
    columns = np.sqrt(2.0) * np.sin(2.0 * np.pi * rate * time + phase)
    if once is not None:
        columns[:, :, once] = columns[:, :, 7] * (np.arange(count) % logs == 0)[:, None]
    lacking = np.array([rng.normal(size=COLUMNS)] * count)
    if paired:
        lacking = np.tile(rng.normal(size=(logs, COLUMNS)), (2, 1))
    lacking = lacks * lacking + loose * rng.normal(size=(count, COLUMNS))
    moved = (shift * after + scatter * rng.normal(size=count))[:, None]
    if parts:
        moved = moved + np.repeat(parts * rng.normal(size=(count, 4)), ROWS // 4, axis=1)
    residual = np.einsum('lrc,lc->lr', columns, lacking) - columns[:, :, 7] * moved
    residual = (residual + 0.1 * rng.normal(size=residual.shape)).ravel()
    whole, numbers = columns.reshape(-1, COLUMNS), np.arange(count) % logs
    fold = np.repeat(numbers, ROWS)
    if min(logs, before) == 1:
        fold = np.arange(count * ROWS) % ROWS * 4 // ROWS
    rows = tuple(slice(k * ROWS, (k + 1) * ROWS) for k in range(count))
    return weigh_changes(
        residual, 5.0 * whole[:, :5], whole, whole[:, :0], 5 + np.arange(COLUMNS),
        [Run(x.start, x.stop, 0) for x in rows], np.arange(count * ROWS) // 100,
        Logs(rows, after, numbers if paired else 0 * numbers, fold),
        most=np.full(COLUMNS, np.inf), usual=np.zeros(COLUMNS),
        alone=np.full(COLUMNS, False), side=np.full(COLUMNS, True), kept=kept,
    )  # fmt: skip


def best(seen: Changes) -> tuple[int, float]:
    told = [evidence_of(seen.of([i])[2], 1) for i in range(COLUMNS)]
    return int(np.argmax(told)), max(told)


@pytest.mark.parametrize(('logs', 'paired'), [(1, False), (3, False), (3, True)])
def test_a_change_is_told_whatever_the_model_lacks_on_both_sides(logs, paired):
    off = []
    for seed in range(12):
        seen = compared(np.random.default_rng(seed), logs, 0.12, paired=paired)
        column, evidence = best(seen)
        (value,), ((variance,),), _ = seen.of([7])
        assert column == 7 and evidence > price_of(COLUMNS)
        off.append((value - 0.12) / np.sqrt(variance))
        assert seen.unseen([7]) > 0.7 * seen.unseen() > 0.0
    assert 0.5 < np.sqrt(np.mean(np.square(off))) < 1.6


def test_nothing_is_told_where_nothing_changed():
    told = [best(compared(np.random.default_rng(seed), 1, 0.0))[1] for seed in range(40)]
    assert sum(evidence > price_of(COLUMNS) for evidence in told) <= 4


def test_what_logs_differ_by_anyway_is_no_change():
    told = [best(compared(np.random.default_rng(seed), 4, 0.0, 0.3))[1] for seed in range(40)]
    assert sum(evidence > price_of(COLUMNS) for evidence in told) <= 10
    alike = compared(np.random.default_rng(0), 4, 0.0)
    apart = compared(np.random.default_rng(0), 4, 0.0, 0.3)
    assert apart.of([7])[1][0, 0] > 20.0 * alike.of([7])[1][0, 0]


def test_a_few_rows_that_columns_follow_wholly_tell_no_change():
    # Half a second of a servo: less rows than what it may lack, the parameters among them.
    for seed in range(4):
        rng = np.random.default_rng(seed)
        residual, columns = rng.normal(size=20), rng.normal(size=(20, 80))
        halves = slice(0, 8), slice(8, 20)
        seen = weigh_changes(
            residual, columns[:, :5], columns[:, 5:], columns[:, :0], np.arange(80),
            [Run(x.start, x.stop, 0) for x in halves], np.arange(20),
            Logs(halves, np.array([False, True]), np.zeros(2, int), np.arange(20) % 4),
            most=np.full(75, np.inf), usual=np.zeros(80), alone=np.full(80, False),
            side=np.full(80, True),
        )  # fmt: skip
        assert max(evidence_of(seen.of([i])[2], 1) for i in range(80)) < price_of(80)


def test_what_changed_differs_from_log_to_log_beside_all_else():
    seen = [
        compared(np.random.default_rng(s), 6, 0.8, 0.3, paired=True, kept=(7,), once=3)
        for s in range(20)
    ]
    assert sum(evidence_of(x.of([3])[2], 1) > price_of(COLUMNS) for x in seen) <= 2
    # Six pairs, of which each is off by 0.3 on both sides.
    assert 1.5 * 0.17 < np.median([x.half_widths() for x in seen]) < 4.0 * 0.17


def test_what_a_single_log_of_a_side_shows_differs_by_as_much_as_all_else():
    for once, most in ((3, 2), (None, 4)):
        seen = [
            compared(np.random.default_rng(s), 4, 0.0, once=once, loose=0.3) for s in range(20)
        ]
        assert sum(best(x)[1] > price_of(COLUMNS) for x in seen) <= most


def test_two_logs_a_side_tell_more_where_all_that_may_change_differs_alike():
    seen = [compared(np.random.default_rng(s), 2, 2.0, loose=0.3) for s in range(20)]
    assert sum(best(x) > (7, price_of(COLUMNS)) for x in seen if best(x)[0] == 7) >= 15
    seen = [compared(np.random.default_rng(s), 2, 0.0, loose=0.3) for s in range(40)]
    assert sum(best(x)[1] > price_of(COLUMNS) for x in seen) <= 4


def test_tails_are_told_apart_however_thin():
    seen = compared(np.random.default_rng(0), 4, 0.5, 0.3)
    assert seen.freedom[7] < 1e3
    gains = [seen.among_logs(x, [7]) for x in (1e4, 1e5, 1e6)]
    assert gains[0] < gains[1] < gains[2]
    assert shown_from(5.0, 8.0) > shown_from(5.0, 80.0) > shown_from(5.0)
    # As probable as 3 standard errors of a normal number: Student's tables.
    assert shown_from(evidence_of(9.0, 1), 10.0) == pytest.approx(3.957, rel=0.01)


def test_one_log_against_several_has_their_scatter():
    told = [
        best(compared(np.random.default_rng(seed), 1, 0.0, 0.3, before=5))[1] for seed in range(40)
    ]
    assert sum(evidence > price_of(COLUMNS) for evidence in told) <= 8


def test_what_parts_of_one_log_differ_by_is_no_change_for_certain():
    wide = {
        parts: [
            compared(np.random.default_rng(seed), 1, 0.0, parts=parts, kept=(7,)).half_widths()
            for seed in range(20)
        ]
        for parts in (0.0, 0.3)
    }
    # Four parts a side of a standard deviation of 0.3: their means are apart by 0.21.
    assert 1.96 * 0.15 < np.median(wide[0.3]) < 4.0 * 0.3
    assert np.median(wide[0.0]) < 0.1


def test_the_smallest_that_shows_is_found_half_the_time():
    (size,) = compared(np.random.default_rng(0), 1, 0.0).shown([7], price_of(COLUMNS))
    for factor, low, high in ((0.6, 0, 4), (1.6, 8, 12)):
        seen = [compared(np.random.default_rng(s), 1, factor * size) for s in range(12)]
        found = sum(evidence_of(x.of([7])[2], 1) > price_of(COLUMNS) for x in seen)
        assert low <= found <= high


def test_the_smallest_that_shows_is_more_than_parts_of_one_log_differ_by():
    price = price_of(COLUMNS)
    # Four parts a side tell their scatter roughly, so that the chance rises slowly.
    chances = (0.3, 0.5, 0, 6), (0.3, 1.0, 8, 14), (0.3, 2.2, 16, 20), (0.0, 1.5, 15, 20)
    for parts, factor, low, high in chances:
        found = 0
        for seed in range(20):
            nothing = compared(np.random.default_rng(seed), 1, 0.0, parts=parts)
            (size,) = nothing.shown([7], price)
            rng = np.random.default_rng(1000 + seed)
            seen = compared(rng, 1, factor * size, parts=parts, kept=(7,))
            covariance = np.linalg.inv(seen.information[[7]][:, [7]] + 1.0)
            estimate = -(covariance @ seen.score[[7]])
            found += evidence_of(seen.beyond(estimate, [0]), 1) > price
        assert low <= found <= high, (parts, factor)


def test_the_smallest_that_shows_is_more_than_the_same_on_both_sides_would_explain():
    # Nothing lacks, so that all of a change is told from nothing; of one in no fit half is common.
    seen = compared(np.random.default_rng(0), 1, 0.0, lacks=0.0)
    plain = shown_from(price_of(COLUMNS)) * np.sqrt(seen.of([7])[1][0, 0])
    (size,) = seen.shown([7], price_of(COLUMNS))
    assert 1.25 * plain < size < 1.6 * plain
    # A limit of the column is one of what is common, too.
    tight = replace(seen, limit=seen.sizes)
    assert tight.shown([7], price_of(COLUMNS)) == pytest.approx(plain, rel=0.05)
