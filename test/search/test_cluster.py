# SPDX-License-Identifier: Apache-2.0
"""Evaluating elsewhere gives the same bits, whoever is lost on the way."""

from collections.abc import Iterator
import math
import os
from pathlib import Path
import signal
import threading
from typing import Any

import numpy as np
import pytest

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.identify.result import Identification
from ros2_ident.identify.run import identify, read_data
from ros2_ident.models import load_machine
from ros2_ident.search import (
    GeneticSearch,
    GeneticSettings,
    minimise,
    StopReason,
    Threads,
)
from ros2_ident.search.evaluators import Cluster

ROOT = Path(__file__).parents[2]
SETTINGS = GeneticSettings(initial_population=64, survivors=4, children=8, generations=4)
LOW, HIGH = np.full(3, -2.0), np.full(3, 3.0)


class Bowl:
    """A paraboloid about 0.7."""

    def prepare(self) -> None:
        pass

    def costs(self, theta: np.ndarray, limit: float = math.inf, stop=None) -> np.ndarray:
        return np.sqrt(((theta - 0.7) ** 2).sum(axis=1))

    def residuals(self, theta: np.ndarray) -> np.ndarray:
        return theta - 0.7


class Broken(Bowl):
    """Fails by itself, which is no loss of a worker."""

    def costs(self, theta: np.ndarray, limit: float = math.inf, stop=None) -> np.ndarray:
        raise IdentError(ErrorCode.BAD_VALUES, 'the bowl has a hole; mend it')


# Of workers in this process: where they may go on, and how many did.
_GO_ON = threading.Event()
_GONE_ON: list[int] = []


class Slow(Bowl):
    """Takes longer than anybody waits."""

    def costs(self, theta: np.ndarray, limit: float = math.inf, stop=None) -> np.ndarray:
        _GO_ON.wait()
        _GONE_ON.append(len(theta))
        return super().costs(theta)


def search() -> GeneticSearch:
    return GeneticSearch(3, SETTINGS, 5)


def run(workers: Any, objective: Any, **more: Any) -> Any:
    with workers.open(objective) as costs:
        return minimise(costs, search(), low=LOW, high=HIGH, **more)


@pytest.fixture(scope='module')
def cluster() -> Iterator[Any]:
    """Return a scheduler with two workers, each a process of its own."""
    distributed = pytest.importorskip('distributed')
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None
    ) as cluster:
        yield cluster


@pytest.fixture(scope='module')
def near() -> Iterator[Any]:
    """Return three workers in this process."""
    distributed = pytest.importorskip('distributed')
    with (
        distributed.LocalCluster(
            n_workers=3, threads_per_worker=1, processes=False, dashboard_address=None
        ) as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
    ):
        yield Cluster(client)


def same(one: Identification, other: Identification) -> None:
    np.testing.assert_array_equal(one.theta, other.theta)
    for name in ('candidates', 'costs', 'generations', 'best_costs'):
        np.testing.assert_array_equal(getattr(one.history, name), getattr(other.history, name))
    assert [(p.low, p.high) for p in one.parameters] == [(p.low, p.high) for p in other.parameters]
    np.testing.assert_equal((one.cost.ga, one.cost.refined), (other.cost.ga, other.cost.refined))
    assert one.evaluations == other.evaluations
    assert dict(one.settings) == dict(other.settings)


def test_failure_of_the_work_is_no_loss_of_the_worker(near: Any) -> None:
    with pytest.raises(IdentError, match='mend it') as caught:
        run(near, Broken())
    assert caught.value.code is ErrorCode.BAD_VALUES


def test_a_cancel_does_not_wait_for_the_workers(near: Any) -> None:
    event = threading.Event()
    with near.open(Slow()) as costs:
        threading.Timer(0.2, event.set).start()
        threading.Timer(60.0, _GO_ON.set).start()  # a search that waits for them fails below
        found = minimise(costs, search(), low=LOW, high=HIGH, cancel=event)
        assert not _GONE_ON
        _GO_ON.set()
    assert found.stop is StopReason.CANCELLED and not found.evaluations


def test_dask_worker_killed_in_mid_run_leaves_the_result_unchanged(cluster: Any) -> None:
    machine = load_machine(ROOT / 'config/emps.yaml')
    data = read_data(ROOT / 'bags/axis_reversals', machine)
    here = identify(machine, data, seed=4)
    victims = [worker.process.pid for worker in cluster.workers.values()]
    killed: list[int] = []

    def kill(progress: Any) -> None:
        if not killed and progress.evaluations > 100:
            os.kill(victims[0], signal.SIGKILL)
            killed.append(progress.evaluations)

    there = identify(
        machine,
        data,
        seed=4,
        workers=Cluster(cluster.scheduler_address),
        on_progress=kill,
    )
    assert killed and killed[0] < here.evaluations
    same(here, there)


def test_work_is_done_here_when_every_dask_worker_is_gone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    distributed = pytest.importorskip('distributed')
    monkeypatch.setattr('ros2_ident.search.evaluators.PATIENCE', 1.0)
    with (
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None
        ) as lonely,
        distributed.Client(lonely) as client,
        Cluster(client).open(Bowl()) as costs,
    ):
        lonely.scale(0)
        there = minimise(costs, search(), low=LOW, high=HIGH)
    np.testing.assert_array_equal(there.theta, run(Threads(1), Bowl()).theta)


def test_no_scheduler_is_said_with_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip('distributed')
    monkeypatch.setattr('ros2_ident.search.evaluators.PATIENCE', 1.0)
    machine = load_machine(ROOT / 'config/emps.yaml')
    data = read_data(ROOT / 'bags/axis_reversals', machine)
    with pytest.raises(IdentError, match='dask scheduler') as caught:
        identify(machine, data, workers=Cluster('tcp://127.0.0.1:1'))
    assert caught.value.code is ErrorCode.INVALID_GOAL
