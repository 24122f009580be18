#!/bin/bash
set -e
source /opt/ros/jazzy/setup.bash
if [ -f /workspace/install/local_setup.bash ]; then source /workspace/install/local_setup.bash; fi
export PATH=/opt/segloc/bin:$PATH PYTHONPATH=/opt/segloc/lib/python3.12/site-packages:$PYTHONPATH
exec "$@"
