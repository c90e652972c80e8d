#!/usr/bin/env bash
# Holds the unit to systemd's own checks: no mistake in it, and next to nothing it may do besides its work.
set -euo pipefail
cd "$(dirname "$0")"

command -v systemd-analyze > /dev/null || apt-get install -y --no-install-recommends systemd > /dev/null
work=$(mktemp -d)
trap 'rm -r "$work"' EXIT
cp ./*.service ./*.target "$work"
# the program itself need not be installed for this
sed -i 's#^ExecStart=/usr/bin/vernissage#ExecStart=/bin/true#' "$work/vernissage.service"
said=$(systemd-analyze --man=no verify "$work/vernissage.service" "$work/vernissage-kiosk.target" 2>&1) || true
said=$(grep -F -e "$work" -e vernissage <<< "$said" || true)
if [ -n "$said" ]; then
  echo "FAIL systemd-analyze verify: $said"
  exit 1
fi
systemd-analyze security --offline=true --threshold=6 vernissage.service | tail -1
echo "PASS units"
