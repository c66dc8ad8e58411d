#!/usr/bin/env bash
# Performance regression test: ratios that do not depend on the machine. Two minutes on two cores.
exec bash "$(dirname "${BASH_SOURCE[0]}")/../study.sh" bench guard "$@"
