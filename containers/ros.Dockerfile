# pushfric in ROS 2, as docs/install.md says. In the folder of the README:
#   docker build -f containers/ros.Dockerfile --build-arg DISTRO=jazzy -t pushfric-ros .
#   docker run --rm pushfric-ros ros2 run pushfric_ros pushfric doctor
ARG DISTRO=jazzy
FROM ros:${DISTRO}
ENV PIP_BREAK_SYSTEM_PACKAGES=1
WORKDIR /pushfric
COPY . .
RUN apt-get update \
    && apt-get install -y --no-install-recommends python3-pip \
    && rosdep update --rosdistro "$ROS_DISTRO" \
    && rosdep install --from-paths src --ignore-src -y \
    && python3 -m pip install osqp 'opencv-python-headless>=4.7' 'pydantic>=2.5' 'shapely>=2.1' 'typer>=0.12.4' \
    && rm -rf /var/lib/apt/lists/*
RUN . "/opt/ros/$ROS_DISTRO/setup.sh" && colcon build
RUN echo '. /pushfric/install/setup.bash' >> /etc/bash.bashrc \
    && printf '#!/bin/bash\n. /pushfric/install/setup.bash\nexec "$@"\n' > /entrypoint && chmod +x /entrypoint
ENTRYPOINT ["/entrypoint"]
CMD ["bash"]
