#!/usr/bin/env bash
# The programs the tests drive that are not Python packages: a browser, the compose file checker, an MQTT broker and a
# database server.
set -euo pipefail
declare -A package_of=([chromium]=chromium [chromedriver]=chromium-driver [docker-compose]=docker-compose [mosquitto]=mosquitto [initdb]=postgresql)
PATH="$PATH:/usr/sbin:$(echo /usr/lib/postgresql/*/bin | tr " " :)"  # where Debian keeps broker and server
missing=()
for program in "${!package_of[@]}"; do
  command -v "$program" >/dev/null || missing+=("${package_of[$program]}")
done
[ ${#missing[@]} -eq 0 ] && exit 0
if [ "$(id -u)" -eq 0 ] && command -v apt-get >/dev/null; then
  echo "==> installing ${missing[*]}"
  export DEBIAN_FRONTEND=noninteractive
  apt-get update -q
  apt-get install -y -q --no-install-recommends "${missing[@]}"
else
  echo "The tests need these Debian packages: ${missing[*]}"
  echo "Install them with:  sudo apt-get install ${missing[*]}"
  exit 1
fi
