# SPDX-License-Identifier: Apache-2.0
"""Many bags of many machines as one job: each identified and diagnosed, then all compared.

A bag is a row. What a row says is kept in a file of the output directory under a key of everything
that it depends on, so that the same call goes on where the last one ended, and does anew what has
changed. A bad bag fails alone.
"""

from ros2_ident.fleet.entries import Entry as Entry
from ros2_ident.fleet.entries import read_fleet as read_fleet
from ros2_ident.fleet.entries import Row as Row
from ros2_ident.fleet.entries import Wish as Wish
from ros2_ident.fleet.run import key_of as key_of
from ros2_ident.fleet.run import run_entry as run_entry
from ros2_ident.fleet.run import run_fleet as run_fleet
from ros2_ident.fleet.summary import sound as sound
from ros2_ident.fleet.summary import summarise as summarise
