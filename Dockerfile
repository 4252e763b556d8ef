# Not run yet: no Docker daemon was at hand. SPDX-License-Identifier: Apache-2.0
#   docker build --target command -t ident .
#   docker run --rm -v "$PWD:/work" -v ident_cache:/cache ident check my_bag
# With the ROS 2 node:
#   docker build -t ros2_ident . && docker run --rm -it --network host --ipc host ros2_ident

FROM python:3.12-slim AS command
COPY . /src
RUN pip install --no-cache-dir '/src[page]'
# what the first run compiles
ENV NUMBA_CACHE_DIR=/cache
WORKDIR /work
ENTRYPOINT ["ident"]

FROM ros:jazzy-ros-base AS tools
RUN apt-get update \
  && apt-get install -y --no-install-recommends build-essential python3-venv ros-dev-tools \
  && rm -rf /var/lib/apt/lists/*

FROM tools AS node
COPY . /ros2_ident
WORKDIR /ros2_ident
RUN bash -c '. /opt/ros/jazzy/setup.bash && make setup'
ENTRYPOINT ["bash", "-c", ". ./env.sh && exec \"$@\"", "bash"]
CMD ["bash"]
