# Runs tests with Cargo, and judges a failure: sourced by .ci/run.
#
# A failed test of several processes runs once more, alone: a machine that is busy can break it. If it passes then, the
# run passes and names it. Tests of the pure crates do not depend on the machine, so they have no second try.

# The programs of tests that work with processes, sockets or clocks.
readonly second_try=" io io_slow node node_slow manager manager_slow gateway gateway_slow lossy_link bag bag_slow cli \
cli_slow injected robot end_to_end end_to_end_slow "
# If more tests fail, the fault is not that of a busy machine.
readonly second_tries_max=8

# FILE: the failed tests of Cargo's output, as lines `PROGRAM TEST`. Cargo adds a hash to the name of a program.
failed_tests() {
    awk '
        /^ +Running / {
            program = $NF
            gsub(/^\(.*\/|-[0-9a-f]+\)$/, "", program)
            listed = 0
        }
        /^ +Doc-tests / { program = "doc"; listed = 0 }
        # The first list has the output of the tests, the second one only names.
        /^failures:$/ { listed++; next }
        /^test result: / { listed = 0 }
        listed == 2 && /^    [^ ]+$/ { print program, $1 }
    ' "$1" | sort -u
}

# FILE: the programs that failed by Cargo's own account.
failed_programs() {
    sed -nE 's/^    `-p ([^ ]+) .*--(test|bin|example) ([^ `]+)`$/\3/p; s/^    `-p ([^ ]+) --(lib|doc)`$/\1 \2/p' "$1"
}

# LOG ARGUMENT...: `cargo test ARGUMENT...`.
run_tests() {
    if cargo test "${@:2}" 2>&1 | tee "$1"; then return 0; fi
    second_tries "$@"
}

# LOG ARGUMENT...: runs what failed of `cargo test ARGUMENT...` once more.
second_tries() {
    local log=$1 program test all=() listed
    shift
    mapfile -t all < <(failed_tests "$log")
    if [ ${#all[@]} -eq 0 ] || [ ${#all[@]} -gt "$second_tries_max" ]; then return 1; fi
    listed=$(printf '%s\n' "${all[@]}")
    while read -r program; do
        # A program that ended without a list was killed, or is a library.
        if [[ $second_try != *" $program "* ]] || ! grep -q "^$program " <<<"$listed"; then
            echo "no second try: $program"
            return 1
        fi
    done < <(failed_programs "$log")
    # Without the filters of the first run.
    local options=()
    for word in "$@"; do
        [ "$word" != -- ] || break
        options+=("$word")
    done
    while read -r program test; do
        printf '\n=== once more, alone: %s %s\n' "$program" "$test"
        cargo test "${options[@]}" --test "$program" -- --exact "$test" 2>&1 | tee "$log.again" || return 1
        # A name that no test has would run nothing.
        grep -q '^test result: ok. 1 passed' "$log.again" || return 1
        echo "$program $test" >>"$flaky"
    done <<<"$listed"
}
