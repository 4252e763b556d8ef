#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# A subscription of depth 10,000 keeps the FIRST 5,000 messages of a burst and loses the newest.
#
# ROS 2 Jazzy: rclpy 7.1.6 over rmw_fastrtps_cpp 8.4.3 (Fast DDS 2.14.5), reliable, KEEP_LAST.
# A subscription of depth 4,000 that is not served during 7,000 messages holds the last 4,000, as
# KEEP_LAST says. One of depth 10,000, which should hold all, holds messages 0 to 4,999. The newest
# 2,000 never come, though both sides are reliable, stay, and wait 10 s; no error, no event. 5,000
# is the default of Fast DDS's ResourceLimitsQosPolicy.max_samples, which rmw does not raise with
# the depth.
#
# Source: https://docs.ros.org/en/jazzy/Concepts/Intermediate/About-Quality-of-Service-Settings.html
# ("Keep last: only store up to N samples, configurable via the queue depth option").
#
# Output seen:
#   depth 4000: taken 4000, from 3000 to 6999
#   depth 10000: taken 5000, from 0 to 4999
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/pip" install --quiet ros-rclpy==7.1.6 ros-std-msgs==5.3.6 \
  ros-rmw-fastrtps-cpp==8.4.3 ros-fastrtps==2.14.5 ros-jazzy-rclpy==7.1.6
cat > "$folder/burst.py" << 'END'
import os

os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
os.environ['RMW_IMPLEMENTATION'] = 'rmw_fastrtps_cpp'
import time

import rclpy
from rclpy.duration import Duration
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Int32

COUNT = 7000
rclpy.init()
node = rclpy.create_node('burst')
for depth, first, last in ((4000, 3000, 6999), (10_000, 0, 4999)):
    taken = []
    qos = QoSProfile(
        depth=depth, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.RELIABLE
    )
    topic = f'burst_{depth}'
    node.create_subscription(Int32, topic, lambda message: taken.append(message.data), qos)
    publisher = node.create_publisher(Int32, topic, qos)
    while not publisher.get_subscription_count():
        time.sleep(0.05)
    time.sleep(1.0)
    for number in range(COUNT):
        publisher.publish(Int32(data=number))
        if number % 10 == 0:
            time.sleep(0.001)
    publisher.wait_for_all_acked(Duration(seconds=10))
    idle = time.monotonic() + 10.0
    while time.monotonic() < idle:
        count = len(taken)
        rclpy.spin_once(node, timeout_sec=0.1)
        if len(taken) > count:
            idle = time.monotonic() + 10.0
    print(f'depth {depth}: taken {len(taken)}, from {taken[0]} to {taken[-1]}')
    assert taken == list(range(first, last + 1)), 'the behaviour has changed'
END
"$folder/env/bin/python" "$folder/burst.py"
