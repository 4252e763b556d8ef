# SPDX-License-Identifier: Apache-2.0
"""Search: the genetic algorithm, its driver, the refinement and the intervals."""

from ros2_ident.search.driver import Budget as Budget
from ros2_ident.search.driver import minimise as minimise
from ros2_ident.search.driver import Progress as Progress
from ros2_ident.search.evaluators import ThreadedEvaluator as ThreadedEvaluator
from ros2_ident.search.evaluators import Threads as Threads
from ros2_ident.search.evaluators import Workers as Workers
from ros2_ident.search.genetic import GeneticSearch as GeneticSearch
from ros2_ident.search.genetic import GeneticSettings as GeneticSettings
from ros2_ident.search.genetic import MANY_MINIMA as MANY_MINIMA
from ros2_ident.search.genetic import StopReason as StopReason
from ros2_ident.search.jacobian import finite_differences as finite_differences
from ros2_ident.search.refine import refine as refine
from ros2_ident.search.refine import RefineStatus as RefineStatus
from ros2_ident.search.uncertainty import intervals as intervals
