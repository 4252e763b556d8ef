# SPDX-License-Identifier: Apache-2.0
"""The search on the belt drive: found from anywhere in the box with at most 2760 simulations."""

from pathlib import Path

import numpy as np

from checks.benchmarks.search_belt import identify, MANY_MINIMA, PAPER_TRUTH, truths


def test_forty_truths_anywhere_in_the_box():
    runs = [identify(truth, MANY_MINIMA, i) for i, truth in enumerate(truths(40, 0))]
    own, refined, evaluations, _ = zip(*runs, strict=True)
    assert sum(bool((e < 0.01).all()) for e in own) >= 38
    assert sum(bool((e < 1e-6).all()) for e in refined) >= 39
    assert max(evaluations) <= 2760


def test_the_example_in_the_docs(monkeypatch, capsys):
    root = Path(__file__).parents[2]
    monkeypatch.chdir(root)
    text = (root / 'docs' / 'search.md').read_text(encoding='utf-8')
    example = text.split('```python\n')[1].split('```')[0]
    scope = {}
    exec(example, scope)
    np.testing.assert_allclose(scope['refined'].theta, [1.83e5, 51.0], rtol=1e-9)
    assert np.isfinite(scope['known'].half_width).all()
    assert 'All generations are done' in capsys.readouterr().out


def test_the_papers_own_truth():
    runs = [identify(PAPER_TRUTH, MANY_MINIMA, s) for s in range(10)]
    refined = np.array([r[1] for r in runs])
    # The paper: EA 0.028 %, P 0.032 %.
    assert ((refined < [2.8e-4, 3.2e-4]).all(axis=1)).sum() >= 9
    assert np.median(refined) < 1e-9
