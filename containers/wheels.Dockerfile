# pushfric on a machine without ROS 2, as docs/install.md says. In the folder of the README:
#   docker build -f containers/wheels.Dockerfile -t pushfric .
#   docker run --rm -p 127.0.0.1:8088:8088 pushfric demo --headless --view 0.0.0.0:8088
# A controller: --device /dev/ttyUSB0, and --group-add dialout.
FROM ubuntu:24.04
RUN apt-get update \
    && apt-get install -y --no-install-recommends ca-certificates python3 g++ make cmake python3-dev python3-venv \
    && rm -rf /var/lib/apt/lists/*
COPY --chown=ubuntu:ubuntu . /home/ubuntu/pushfric
USER ubuntu
WORKDIR /home/ubuntu/pushfric
RUN ./pushfric setup
ENTRYPOINT ["./pushfric"]
CMD ["--help"]
