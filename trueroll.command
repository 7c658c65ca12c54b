#!/bin/sh
# A double click on this file opens the page of trueroll; the first time, everything is installed into .venv before.
cd "$(dirname "$0")" && make app && exit
echo "trueroll could not be started; the lines above say why. Press Enter to close this window."
read -r _
