# SPDX-License-Identifier: Apache-2.0
"""Recordings of drives: bags and live topics as arrays, on the controller's time grid, judged."""

from ros2_ident.recording.align import align as align
from ros2_ident.recording.bag import read_bag as read_bag
from ros2_ident.recording.bag import read_bags as read_bags
from ros2_ident.recording.bag import Topics as Topics
from ros2_ident.recording.builder import LIVE as LIVE
from ros2_ident.recording.builder import RecordingBuilder as RecordingBuilder
from ros2_ident.recording.motion import smooth_motion as smooth_motion
from ros2_ident.recording.quality import check as check
from ros2_ident.recording.quality import Finding as Finding
from ros2_ident.recording.quality import render as render
from ros2_ident.recording.quality import Report as Report
from ros2_ident.recording.streams import Dataset as Dataset
from ros2_ident.recording.streams import Recording as Recording
from ros2_ident.recording.streams import scale_effort as scale_effort
from ros2_ident.recording.streams import Stream as Stream
from ros2_ident.recording.streams import StreamQuality as StreamQuality
from ros2_ident.recording.windows import choose_windows as choose_windows
from ros2_ident.recording.windows import SAMPLES as SAMPLES
from ros2_ident.recording.write import write_bag as write_bag
