#!/usr/bin/env bash
# Traversals of the Oxford RobotCar dataset by one push-broom scanner: into one frame, to training
# data, to a network; a map of the first, and the last localized in it.
#
#   examples/robotcar.sh OUT TRAVERSAL TRAVERSAL...
#
# TOPIC is the scanner, NETWORK and STEPS say what is trained and for how long. Poses are those that
# come with the traversals; they may drift.
set -euo pipefail

if [ $# -lt 3 ]; then
  sed -n '2,8s/^# \{0,1\}//p' "$0" >&2
  exit 2
fi
out=$1
shift
first=$1 last=${!#} final=$(($# - 1))
topic=${TOPIC:-lms_front} network=${NETWORK:-dsm} threads=${THREADS:-1}
mkdir -p "$out"

for traversal in "$@"; do
  segloc info "$traversal" --topic "$topic"
done

# All traversals in the frame of the first, and pairs of segments of all of them.
segloc align "$@" --topic "$topic" --threads "$threads" --out "$out/aligned"
segloc train pairs "$@" --topic "$topic" --aligned "$out/aligned" --out "$out/dataset"

segloc train "$network" "$out/dataset" --steps "${STEPS:-5000}" --threads "$threads" \
  --out "$out/$network.safetensors"
segloc train score "$out/$network.safetensors" "$out/dataset" --threads "$threads"

# The aligned poses of the last traversal are only scored against.
segloc map build "$first" --topic "$topic" --poses "$out/aligned/session_0.tum" \
  --threads "$threads" --out "$out/site.segmap"
segloc localize "$last" --topic "$topic" --map "$out/site.segmap" --every "${EVERY:-10}" \
  --truth "$out/aligned/session_$final.tum" --threads "$threads" --out "$out/results"
