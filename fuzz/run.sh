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
host=$(rustc -vV | sed -n 's/^host: //p')
# With `--target` the flags are those of the targets alone, not of the scripts that build them.
RUSTFLAGS="--cfg fuzzing -Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4 \
-Cllvm-args=-sanitizer-coverage-inline-8bit-counters -Cllvm-args=-sanitizer-coverage-pc-table \
-Cllvm-args=-sanitizer-coverage-trace-compares -Cdebug-assertions -Ccodegen-units=16" cargo build --release --target "$host" --config profile.release.opt-level=2
status=0
echo "| reader | seconds | inputs | inputs per s | memory (MB) | collected | found |"
echo "| --- | ---: | ---: | ---: | ---: | ---: | --- |"
for target; do
    mkdir -p "corpus/$target" "artifacts/$target"
    found=nothing
    "target/$host/release/$target" "corpus/$target" "seeds/$target" -max_total_time="$seconds" -timeout=10 -rss_limit_mb=1024 -detect_leaks=0 \
        -max_len=16384 -artifact_prefix="artifacts/$target/" -print_final_stats=1 >"artifacts/$target.log" 2>&1 || { found=$(ls -t "artifacts/$target" | head -1); status=1; }
    value() { sed -n "s/^stat::$1: *//p" "artifacts/$target.log"; }
    echo "| $target | $seconds | $(value number_of_executed_units) | $(value average_exec_per_sec) | $(value peak_rss_mb) | $(ls "corpus/$target" | wc -l) | $found |"
done
exit $status
