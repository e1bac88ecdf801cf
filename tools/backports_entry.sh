#!/usr/bin/env bash
# Prints an apt source entry for CODENAME-backports, copied from the machine's own entry for CODENAME
# with only the suite changed: the mirror that this machine already trusts and reaches is used.
#
#   tools/backports_entry.sh CODENAME [APT_FOLDER]     APT_FOLDER: /etc/apt
#
# First line of the output: `sources` or `list`, the suffix that the entry's file needs.
set -euo pipefail

codename=$1
apt=${2:-/etc/apt}

# deb822 form: paragraphs of `Key: value`; comments are left out, other keys (Signed-By) are kept.
for file in "$apt"/sources.list.d/*.sources; do
    [ -f "$file" ] || continue
    entry=$(sed '/^#/d' "$file" | awk -v codename="$codename" '
        BEGIN { RS = ""; FS = "\n" }
        {
            binary = 0; enabled = 1; ours = 0; text = ""
            for (i = 1; i <= NF; i++) {
                line = $i; key = tolower(line); sub(/:.*/, "", key)
                count = split(line, word, /[ \t]+/)
                if (key == "types") for (j = 2; j <= count; j++) if (word[j] == "deb") binary = 1
                if (key == "enabled" && tolower(word[2]) == "no") enabled = 0
                if (key == "suites") {
                    for (j = 2; j <= count; j++) if (word[j] == codename) ours = 1
                    line = "Suites: " codename "-backports"
                }
                text = text line "\n"
            }
            if (binary && enabled && ours) { printf "%s", text; exit }
        }')
    if [ -n "$entry" ]; then
        printf 'sources\n%s\n' "$entry"
        exit 0
    fi
done

# One-line form: deb [options] URI SUITE COMPONENT...
for file in "$apt"/sources.list "$apt"/sources.list.d/*.list; do
    [ -f "$file" ] || continue
    entry=$(awk -v codename="$codename" '
        $1 == "deb" {
            for (i = 3; i < NF; i++) if ($i == codename) { $i = codename "-backports"; print; exit }
        }' "$file")
    if [ -n "$entry" ]; then
        printf 'list\n%s\n' "$entry"
        exit 0
    fi
done

echo "$apt: found no entry for the suite '$codename' to copy" >&2
exit 1
