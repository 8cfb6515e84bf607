#!/bin/sh
# Fuzzes readers with libFuzzer, on a stable toolchain and without cargo-fuzz:
#
#     fuzz/run.sh SECONDS [TARGET...]
#
# builds the targets with the coverage counters that cargo-fuzz asks for, runs each (all without a name) for so many seconds, beginning with
# its small files and what earlier runs collected in fuzz/corpus, and prints a table. It ends with 1 if an input makes a reader panic, takes
# more than 10 s or more than 1 GB; such inputs are kept in fuzz/artifacts.
set -eu
cd "$(dirname "$0")"
seconds=${1:?how many seconds each}
shift
[ $# -gt 0 ] || set -- $(cd fuzz_targets && ls | sed 's/\.rs$//')
export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-$PWD/../target}"
RUSTC_WRAPPER="$PWD/counters.sh" cargo build --profile fuzz --locked
status=0
echo "| reader | seconds | inputs | inputs per s | memory (MB) | collected | found |"
echo "| --- | ---: | ---: | ---: | ---: | ---: | --- |"
for target; do
    mkdir -p "corpus/$target" "artifacts/$target"
    found=nothing
    "$CARGO_TARGET_DIR/fuzz/$target" "corpus/$target" "seeds/$target" -max_total_time="$seconds" -timeout=10 -rss_limit_mb=1024 -detect_leaks=0 \
        -max_len=16384 -artifact_prefix="artifacts/$target/" -print_final_stats=1 >"artifacts/$target.log" 2>&1 || { found=$(ls -t "artifacts/$target" | head -1); status=1; }
    value() { sed -n "s/^stat::$1: *//p" "artifacts/$target.log"; }
    echo "| $target | $seconds | $(value number_of_executed_units) | $(value average_exec_per_sec) | $(value peak_rss_mb) | $(ls "corpus/$target" | wc -l) | $found |"
done
exit $status
