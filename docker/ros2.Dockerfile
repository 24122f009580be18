# segloc beside ROS 2 Jazzy, with the node where the clone has one (ros2/):
#   docker build -t segloc-ros -f docker/ros2.Dockerfile .
#   docker run --rm -it --network host -v ~/maps:/maps segloc-ros \
#     ros2 launch segloc_ros lidar_alone.launch.py map:=/maps/site.segmap points:=/points
FROM ros:jazzy-ros-base AS build
RUN apt-get update && apt-get install -y --no-install-recommends \
      g++ python3-venv python3-colcon-common-extensions && rm -rf /var/lib/apt/lists/*
WORKDIR /source
COPY pyproject.toml CMakeLists.txt README.md LICENSE ./
COPY cpp cpp
COPY src src
# The environment sees rclpy of the system, whose NumPy is older than pip would choose.
RUN python3 -m venv --system-site-packages /opt/segloc && \
    /opt/segloc/bin/pip install --no-cache-dir '.[odometry,geo]'
COPY ros2* /workspace/src/
RUN . /opt/ros/jazzy/setup.sh && . /opt/segloc/bin/activate && \
    cd /workspace && mkdir -p install && \
    if [ -n "$(find src -name package.xml)" ]; then python -m colcon build; fi

FROM ros:jazzy-ros-base
RUN useradd --create-home segloc
COPY --from=build /opt/segloc /opt/segloc
COPY --from=build /workspace/install /workspace/install
COPY docker/ros2-entrypoint.sh /ros2-entrypoint.sh
USER segloc
WORKDIR /home/segloc
# On SIGTERM ros2 launch leaves its nodes running, on SIGINT it ends them.
STOPSIGNAL SIGINT
ENTRYPOINT ["/ros2-entrypoint.sh"]
CMD ["segloc", "--help"]
