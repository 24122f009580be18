#!/usr/bin/env bash
# All shipped weights from nothing: worlds, a dataset of their segments, networks, FC4, forests.
#   lab/src/segloc_lab/weights/train_weights.sh OUT
# Every network and forest learns from the same worlds; which step of a training is kept is decided
# on simulated worlds that are held out, and no recording takes part. The cards name the commit.
# On two cores half an hour for the dataset, and an hour and a half for all networks (`esm` and
# `segmap` need most of it). What is done stays: started again, it goes on where it was.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
commit=$(git -C "$here" describe --always --dirty --abbrev=12)
mkdir -p "$1" && cd "$1"
export OPENBLAS_NUM_THREADS=1
# Other sources would go on with what these began.
[ ! -e commit ] || [ "$(cat commit)" = "$commit" ] ||
  { echo "$PWD was begun at commit $(cat commit), this is $commit: name another folder" >&2; exit 1; }
echo "$commit" > commit
extract() { segloc train extract --simulate "$1" --drive 300 --thin 2 --seed "$2" --out "$3"; }
extract town:5,park:2,meadow:2,forest:2,industrial:2 5 worlds
train() {
  for network; do
    cp "$here/train_$network.yaml" .  # cards then name no folder of this machine
    [ -e "$network.safetensors" ] || segloc train "$network" worlds --commit "$commit" \
      --config "train_$network.yaml" --threads 1 --out "$network.safetensors"
  done
}
train segmap profile &
first=$!
train esm dsm
wait "$first"
for method in segmatch-eigen segmatch-esf nsm; do
  [ -e "$method-forest.safetensors" ] || segloc train forest "$method" worlds \
    --commit "$commit" --out "$method-forest.safetensors"
done
# How good they are in worlds that took no part, also where things repeat.
extract town:1,park:1,meadow:1,forest:1,industrial:1 77 others
extract terraces:1,car_park:1 78 repeated
for name in geo {profile,dsm,esm,segmap}.safetensors; do
  for set in others repeated; do segloc train score "$name" "$set"; done
done
