# SPDX-License-Identifier: Apache-2.0
"""The edge to ROS 2: the nodes, their parameters and messages. Nothing else imports rclpy."""
