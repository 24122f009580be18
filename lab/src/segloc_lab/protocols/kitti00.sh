#!/usr/bin/env bash
# The protocols on real scans: KITTI odometry 00 as keyframes and full scans with TUM poses.
#   lab/src/segloc_lab/protocols/kitti00.sh DATA OUT METHOD...
# Runs that are there are not repeated. Without DATA/scans the protocol "single" is left out. Several
# of these scripts may fill one OUT at once, each with methods of its own.
set -euo pipefail
data=$1 out=$2
shift 2
segloc=${SEGLOC:-segloc}
mkdir -p "$out"

build() {  # MAP METHOD ARGUMENTS...
  local map="$out/$1-$2.segmap" method=$2
  shift 2
  [ -e "$map" ] || $segloc map build "$data/keyframes" --poses keyframes.tum "$@" \
    --method "$method" --threads 1 --out "$map"
}

localize() {  # RUN METHOD MAP ARGUMENTS...
  local run="$out/$1-$2" map="$out/$3-$2.segmap" method=$2
  shift 3
  [ -e "$run/summary.json" ] && return
  $segloc localize "$@" --map "$map" --threads 1 --out "$run"
}

for method in "$@"; do
  # Accumulated: the first half of the drive is the map, queries are all of the rest, every 10 m.
  build first "$method" --select 100:947
  localize accumulated "$method" first "$data/keyframes" --poses keyframes.tum --select 948:1820 \
    --every 10 --truth keyframes.tum
  # Sparse: the same places, one thinned keyframe each.
  localize sparse "$method" first "$data/keyframes" --select 948:1820 --every 10 \
    --truth keyframes.tum
  # One-shot: a map of the later passes, and every full scan of the first 827 m by itself.
  [ -d "$data/scans" ] || continue
  build later "$method" --select 619:654,988:1003,1361:1600
  localize single "$method" later "$data/scans" --truth scans.tum
done
