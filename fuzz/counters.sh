#!/bin/sh
# The compiler for `run.sh`, as RUSTC_WRAPPER: calfit and its targets get the coverage counters that libFuzzer goes by, and checks of debug
# builds; the libraries that they use are built as in any release build, and are taken from it.
case "${CARGO_PKG_NAME:-} $*" in
*build_script_build*) exec "$@" ;;
"calfit "* | "calfit-fuzz "*)
    exec "$@" --cfg fuzzing -Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4 \
        -Cllvm-args=-sanitizer-coverage-inline-8bit-counters -Cllvm-args=-sanitizer-coverage-pc-table \
        -Cllvm-args=-sanitizer-coverage-trace-compares -Cdebug-assertions -Coverflow-checks -Copt-level=2 -Cstrip=none -Cdebuginfo=line-tables-only
    ;;
*) exec "$@" ;;
esac
