# ROS 2 Jazzy on Ubuntu 24.04, for amd64 and arm64 (the base image has both):
#   docker build -t pam_antagonist .
#   docker run --rm -it pam_antagonist demo
#   docker run --rm -it -v "$PWD:/data" -w /data pam_antagonist replay my_bag --rig shin2022 --out result
FROM ros:jazzy-ros-base AS tools
RUN apt-get update \
    && apt-get install -y --no-install-recommends build-essential cmake python3-dev python3-venv \
    && rm -rf /var/lib/apt/lists/*

FROM tools
WORKDIR /opt/pam_antagonist
COPY . .
# Sets up .venv beside the installed Jazzy and builds the messages; compiles what a replay needs.
RUN ./run simulate --rig shin2022 --duration 2 --profile steps --out /tmp/bag \
    && ./run replay /tmp/bag --rig shin2022 --no-figures --out /tmp/report \
    && rm -rf /tmp/bag /tmp/report
ENTRYPOINT ["/opt/pam_antagonist/run"]
CMD ["--help"]
