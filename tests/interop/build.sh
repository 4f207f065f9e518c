#!/bin/sh
# Builds the robot on Fast DDS into a folder: build.sh FOLDER. Needs Debian's libfastrtps-dev, fastddsgen and g++.
set -e
here=$(cd "$(dirname "$0")" && pwd)
mkdir -p "$1"
cd "$1"
if [ ! -e types.a ] || [ "$here/ros.idl" -nt types.a ]; then
    fastddsgen -replace -d . "$here/ros.idl" >fastddsgen.log
    g++ -std=c++17 -O1 -I. -c ./*.cxx
    ar rcs types.a ./*.o
fi
if [ ! -e peer ] || [ "$here/peer.cpp" -nt peer ] || [ types.a -nt peer ]; then
    g++ -std=c++17 -O1 -Wall -I. "$here/peer.cpp" types.a -lfastrtps -lfastcdr -pthread -o peer
fi
