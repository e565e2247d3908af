# The steps of both tiers: sourced by .ci/run.

# On a CI machine cargo-deny is built where it is missing; at a desk only if asked for.
: "${SM2_CI_INSTALL_DENY:=$([ -n "${CI:-}" ] && echo 1 || echo 0)}"
export SM2_CI_INSTALL_DENY
# A clean clone is built once: what incremental builds keep would only fill its disk.
[ -z "${CI:-}" ] || export CARGO_INCREMENTAL=${CARGO_INCREMENTAL:-0}
# On a CI machine, a test that cannot use one of these programs fails instead of being skipped.
[ -z "${CI:-}" ] || export SM2_INSTALLED="ip tc nft bwrap strace"
# Tests wait more than they compute.
export RUST_TEST_THREADS=${RUST_TEST_THREADS:-$((2 * $(nproc)))}
export CI=true
[ -f "${CARGO_HOME:-$HOME/.cargo}/env" ] && . "${CARGO_HOME:-$HOME/.cargo}/env"

export CARGO_TARGET_DIR=${CARGO_TARGET_DIR:-$root/target}
# Programs that `install` has built.
export PATH=$CARGO_TARGET_DIR/tools/bin:$PATH
readonly skipped=77 full=${SM2_CI_FULL:-0}
readonly logs=$CARGO_TARGET_DIR/steps
readonly flaky=$logs/flaky.txt
export SM2_SKIPPED=$logs/skipped.txt
readonly skips=$SM2_SKIPPED

readonly tier1=(tools commits fmt clauses publish deny no-std clippy doc test modes models
    bag ros book c python bridges foxglove view)
# Tier 2: `first` one after the other, then `long` and `beside` side by side.
readonly first=(tools commits fmt clauses publish no-std clippy doc test modes demo faults soak)
readonly long=(asan check aarch64)
readonly beside=(deny micro bag ros book c python bridges foxglove view package mutants)
readonly tier2=("${first[@]}" "${long[@]}" "${beside[@]}")
# The time limit of each step, in seconds: about three times what it takes on a quiet machine of two cores.
declare -rA limits=([tools]=600 [commits]=60 [fmt]=60 [clauses]=300 [publish]=120 [deny]=900 [no-std]=150 [clippy]=600
    [doc]=300 [test]=$((full ? 3600 : 1200)) [modes]=400 [models]=400 [asan]=1500 [micro]=600 [check]=5400 [demo]=1200 [faults]=600
    [soak]=900 [aarch64]=3600 [bag]=900 [ros]=900 [book]=900 [c]=1800 [python]=1800 [bridges]=2400 [foxglove]=2400
    [view]=900 [package]=5400 [mutants]=9000)

# Packages outside the workspace, each a workspace of its own.
readonly outside=(bench/micro verification/no-std verification/loom-models verification/symbolic/kani fuzz)
# The longest subject of a commit, in characters, and the last commit that exceeds it.
readonly subject_max=72 old_subjects=aa5f24603213cf5070f4fc1db0b3a3346c00c204

# The modules of the programs `node` and `end_to_end` whose course depends on the ring lane, and on background threads;
# the others choose both themselves, or have no node. Tests in processes of their own inherit the variables.
readonly with_both=(asynchronous domain embedded event_loop events examples executor hostile hostile_manager leaks
    lifetimes manager_change mapped_bytes max_len qos reserve resident services shutdown topics
    crash isolation shared_memory takeover takeover_gap)
readonly with_ring=(shortage wait_set_calls)
readonly with_background=(detach full_socket many params pool_limit ring ring_calls ring_waits sealed)

# The feature of the slow tests, in tier 2.
slow=()
[ "$full" = 0 ] || slow=(--features slow)

skip() {
    echo "skipped: $1"
    exit "$skipped"
}

# The hash of all files of the repository below the given paths.
hash_of() {
    git ls-files -z -- "$@" | LC_ALL=C sort -z | xargs -0 sha256sum | sha256sum | cut -d' ' -f1
}

# Skips the step if nothing below the given paths changed since it last passed.
unless_stamped() {
    local step=$1
    shift
    if [ "$full" = 0 ] && [ "$(cat ".ci/stamps/$step" 2>/dev/null)" = "$(hash_of "$@")" ]; then
        skip "its inputs have not changed since it last passed; .ci/full runs it"
    fi
}

# Records that the step passed with the files below the given paths.
stamp() {
    local step=$1
    shift
    mkdir -p .ci/stamps
    hash_of "$@" >".ci/stamps/$step"
}

# PROGRAM [OPTION...]: builds a program of crates.io in the target folder, if it is missing. It runs for seconds, so
# nothing of it is optimized.
install() {
    command -v "$1" >/dev/null && return
    CARGO_TARGET_DIR=$CARGO_TARGET_DIR/tools/build \
        cargo install -q --debug --locked --root "$CARGO_TARGET_DIR/tools" "$@" || return
    rm -rf "$CARGO_TARGET_DIR/tools/build"
}

# PACKAGE...: installs packages of Debian. The lanes of tier 2 take turns: apt-get does not wait for another one.
apt_install() {
    local apt_get=(flock --close "$logs/apt.lock")
    [ "$(id -u)" -eq 0 ] || apt_get+=(sudo -n)
    apt_get+=(apt-get)
    "${apt_get[@]}" update && DEBIAN_FRONTEND=noninteractive "${apt_get[@]}" install -y "$@"
}

# Installs packages of Debian whose program is missing. Reads lines `PACKAGE PROGRAM`.
install_packages() {
    local missing=() package program
    while read -r package program; do
        (PATH=$PATH:/usr/sbin:/sbin && command -v "$program") >/dev/null || missing+=("$package")
    done
    if [ ${#missing[@]} -gt 0 ]; then
        apt_install "${missing[@]}" ||
            echo "cannot be installed here, so their tests are skipped: ${missing[*]}"
    fi
}

# Installs the tools of the other steps: a linker, rustfmt, clippy, the locked crates. Further programs make bad links of
# network namespaces, confine processes and let their system calls fail; without them their tests are skipped.
step_tools() {
    install_packages <<<"build-essential cc
iproute2 ip
nftables nft
bubblewrap bwrap
strace strace"
    cargo fmt --version >/dev/null 2>&1 || rustup component add rustfmt || true
    cargo clippy --version >/dev/null 2>&1 || rustup component add clippy || true
    cargo --version
    rustc --version
    cargo fmt --version
    cargo clippy --version
    cargo fetch --locked
}

# Subjects of the commits since the newest tag, or since the last commit with a long subject. A
# shallow clone may have neither: then all commits that it has are newer.
step_commits() {
    git rev-parse --git-dir >/dev/null 2>&1 || skip "this is no git repository"
    # Lengths are those of characters, not of bytes.
    local LC_ALL=C.UTF-8 range=HEAD base subject wrong=0
    base=$(git describe --tags --abbrev=0 2>/dev/null) || base=$old_subjects
    if git merge-base --is-ancestor "$base" HEAD 2>/dev/null; then range=$base..HEAD; fi
    while IFS= read -r subject; do
        if [ "${#subject}" -gt "$subject_max" ]; then
            echo "${#subject} characters, $subject_max at most: $subject"
            wrong=1
        fi
    done < <(git log --no-merges --format=%s "$range")
    echo "checked $(git rev-list --no-merges --count "$range") commits of $range"
    return "$wrong"
}

step_fmt() {
    cargo fmt --all --check
    local package
    for package in "${outside[@]}"; do
        cargo fmt --manifest-path "$package/Cargo.toml" --check
    done
}

# The clauses of SPEC.md, and the code and checks that cite them. Built as a test, because the step `test` then builds
# nothing of it again.
step_clauses() {
    cargo test --workspace "${slow[@]}" --locked --no-run --test verification
    "$CARGO_TARGET_DIR/debug/clauses"
}

step_clippy() {
    cargo clippy --workspace --all-targets --all-features --locked -- -D warnings
}

step_doc() {
    RUSTDOCFLAGS="-D warnings" cargo doc --workspace --no-deps --all-features --locked
}

# Advisories need a clone of their database: the workflow checks them.
step_deny() {
    local inputs=(Cargo.lock deny.toml)
    unless_stamped deny "${inputs[@]}"
    if ! command -v cargo-deny >/dev/null; then
        [ "$SM2_CI_INSTALL_DENY" = 1 ] ||
            skip "cargo-deny is not installed; SM2_CI_INSTALL_DENY=1 builds it (minutes)"
        install cargo-deny || skip "cargo-deny cannot be built here"
    fi
    cargo deny --locked check licenses bans sources
    stamp deny "${inputs[@]}"
}

# Packages all published crates as an upload would, without building them again. Cargo needs
# the registry's index for it.
step_publish() {
    timeout 60 cargo info -q serde >/dev/null 2>&1 || skip "the registry's index cannot be reached"
    cargo publish --dry-run --workspace --no-verify --allow-dirty --locked
}

# sm2-proto without std: a host library with a panic handler of its own, which
# does not link if anything below it brings std along.
step_no-std() {
    CARGO_TARGET_DIR=$CARGO_TARGET_DIR/no-std \
        cargo build --release --locked --manifest-path verification/no-std/Cargo.toml
}

# README's command; in tier 2 with the slow tests.
step_test() {
    rm -f "$CARGO_TARGET_DIR/tested.log"
    run_tests "$logs/tests.log" --workspace "${slow[@]}" --no-fail-fast
    # The step `check` then need not run the same tests again.
    mv "$logs/tests.log" "$CARGO_TARGET_DIR/tested.log"
}

# Nodes without the ring lane, and without background threads: the tests whose course depends on it. Both wait most of
# the time, so they run side by side.
step_modes() {
    local of=(--workspace "${slow[@]}" --no-fail-fast --test node --test end_to_end --) ring background failed=0
    local ring_log=$logs/ring-off.log background_log=$logs/background-off.log
    SM2_RING_LANE=off cargo test "${of[@]}" "${with_both[@]/%/::}" "${with_ring[@]/%/::}" >"$ring_log" 2>&1 &
    ring=$!
    SM2_BACKGROUND=off cargo test "${of[@]}" "${with_both[@]/%/::}" "${with_background[@]/%/::}" 2>&1 |
        tee "$background_log" || background=failed
    wait "$ring" || ring=failed
    cat "$ring_log"
    # A second try is alone, so both modes end before it.
    if [ "${background:-}" = failed ]; then
        SM2_BACKGROUND=off second_tries "$background_log" "${of[@]}" || failed=1
    fi
    if [ "$ring" = failed ]; then SM2_RING_LANE=off second_tries "$ring_log" "${of[@]}" || failed=1; fi
    return "$failed"
}

# The quick scopes of the models, which search every order of events with the shipped machines.
step_models() {
    local inputs=(sm2-proto verification)
    unless_stamped models "${inputs[@]}"
    verification/check --quick --only model
    stamp models "${inputs[@]}"
}

# AddressSanitizer over the tests of the crates that have unsafe code: all other crates forbid it, or have
# none (`grep -rnE 'unsafe (\{|fn|impl)' --include=*.rs .`; bench is a workspace of its own). Some tests stay out. The
# sanitizer makes mlock do nothing (lock) and touches pages of its own (allocation). One starts an example, and this
# build has none (testing). The others have no unsafe code, and take minutes or wait for a short time only
# (asynchronous).
step_asan() {
    [ "$(uname -sm)" = "Linux x86_64" ] || skip "the sanitizer is set up for Linux on x86_64"
    cargo +nightly --version >/dev/null 2>&1 ||
        skip "no nightly compiler; rustup toolchain install nightly --profile minimal"
    local out=() name
    for name in lock::a_segment_is_locked lock::a_refusal_says asynchronous:: examples:: quic_link:: \
        testing::a_program_connects; do
        out+=(--skip "$name")
    done
    # Threads that still wait at the end of a test own memory: tests/leaks.rs looks for leaks.
    ASAN_OPTIONS=detect_leaks=0 RUSTFLAGS=-Zsanitizer=address \
        CARGO_TARGET_DIR=$CARGO_TARGET_DIR/asan \
        cargo +nightly test --locked --no-fail-fast --target x86_64-unknown-linux-gnu \
        -p sm2-io -p sm2-node --lib --test io --test node -- "${out[@]}"
}

# The benchmarks of single steps, once each.
step_micro() {
    (
        cd bench/micro
        export CARGO_TARGET_DIR=$CARGO_TARGET_DIR/micro
        cargo clippy --all-targets --locked -- -D warnings
        cargo bench --locked --bench counters --bench machine --bench message -- --test
    )
}

# Citations, proof harnesses, models, fuzzing, mutants: what fails soon comes first. Tests that the step `test` of this
# run has passed do not run again.
step_check() {
    if [ -f "$CARGO_TARGET_DIR/tested.log" ]; then export SM2_TESTED=$CARGO_TARGET_DIR/tested.log; fi
    verification/check --quick
}

# Builds the programs as they are shipped, once for all steps that run them.
build_programs() {
    cargo build --release --locked --workspace --bin sm2 --bin sm2-manager --bin sm2-gateway --bin soak
}

step_demo() {
    build_programs
    local integrity
    for integrity in pooled sealed; do
        SM2=$CARGO_TARGET_DIR/release/sm2 .ci/demo "$integrity" 3
    done
}

# The programs as they are shipped, while one of their system calls fails.
step_faults() {
    build_programs
    SM2_BINARIES=$CARGO_TARGET_DIR/release cargo test --locked --workspace "${slow[@]}" --test injected
}

# A domain under load, with random kills and stops: its last line has the figures.
step_soak() {
    build_programs
    timeout 600 "$CARGO_TARGET_DIR/release/soak" --seconds 60 --json
}

# Bags, read with the MCAP library for Python and with the Python package rosbags.
step_bag() {
    local inputs=(sm2-bag sm2-ros/oracle/messages.py)
    unless_stamped bag "${inputs[@]}"
    if [ "$full" = 1 ]; then
        build_programs
        SM2=$CARGO_TARGET_DIR/release/sm2 sm2-bag/oracle/run
    else
        sm2-bag/oracle/run
    fi
    stamp bag "${inputs[@]}"
}

# Hashes and messages of ROS 2's types, compared with the Python package rosbags.
step_ros() {
    local inputs=(sm2-ros)
    unless_stamped ros "${inputs[@]}"
    sm2-ros/oracle/run
    stamp ros "${inputs[@]}"
}

# Whether each link of the built book in this folder leads to a file. 404.html links to the root of the site.
has_live_links() {
    local page link file dead=0
    while IFS=: read -r page link; do
        link=${link#*\"}
        link=${link%[\"#]}
        file=$(dirname "$page")/${link%%\?*}
        case $link in /*) continue ;; esac
        [ -e "$1/$file" ] || { echo "$page: no file for the link $link" && dead=1; }
    done < <(cd "$1" && grep -roE --include='*.html' '(href|src)="[^"#:]+["#]' . | sort -u)
    return "$dead"
}

# The book, with mdbook. Its headings that links name and its programs are tests of the step `test`.
step_book() {
    local reference=reference::the_reference_has_the_commands_of_clap
    local inputs=(docs SPEC.md examples sm2-cpp/examples sm2-node/examples sm2-python/examples sm2-ros/example sm2-ros/examples)
    (cd docs/pictures && sha256sum --check --quiet made.sha256) ||
        { echo "docs/pictures: a picture is older than its source; run docs/pictures/make" && false; }
    unless_stamped book "${inputs[@]}"
    install mdbook --no-default-features --features search || skip "mdbook cannot be built here"
    SM2_WRITE_REFERENCE=1 cargo test -q --locked -p sm2-cli --lib -- --exact "$reference"
    mdbook build --dest-dir "$CARGO_TARGET_DIR/book" docs
    # mdbook only logs that a file to include is missing.
    grep -q 'id="sm2-man"' "$CARGO_TARGET_DIR/book/commands.html" ||
        { echo "the book has no reference of the commands" && false; }
    has_live_links "$CARGO_TARGET_DIR/book" || return
    stamp book "${inputs[@]}"
}

# The library for C and C++, a workspace of its own, with its header and its programs. A tool that cannot be installed
# leaves out its part.
step_c() {
    local inputs=(sm2-c sm2-cpp) manager=$CARGO_TARGET_DIR/debug/sm2-manager
    unless_stamped c "${inputs[@]}"
    command -v cc >/dev/null || skip "there is no C compiler"
    install_packages <<<"g++ g++
clang clang++
cmake cmake
doxygen doxygen
valgrind valgrind"
    install cbindgen || skip "cbindgen cannot be built here"
    # Any Rust that SM2 supports builds this version of cargo-c. It needs the headers of OpenSSL.
    command -v cargo-cinstall >/dev/null || install cargo-c@0.10.16 --bin cargo-cinstall ||
        echo "cargo-c cannot be built here"
    cargo build --workspace --locked --bin sm2-manager
    (
        cd sm2-c
        export CARGO_TARGET_DIR=$CARGO_TARGET_DIR/c
        cargo fmt --all --check
        cargo clippy --all-targets --locked -- -D warnings
        cargo test --locked
        cargo build --locked --lib --examples
        cbindgen --quiet --verify --output include/sm2.h ||
            { echo "sm2-c/include/sm2.h is not that of the sources: cbindgen --output include/sm2.h" && false; }
        SM2_MANAGER=$manager tests/run
    )
    stamp c "${inputs[@]}"
}

# The package for Python: its wheel, its tests, and mypy over its examples.
step_python() {
    local inputs=(sm2-python)
    unless_stamped python "${inputs[@]}"
    sm2-python/check
    stamp python "${inputs[@]}"
}

# The bridges to other middlewares: a workspace of its own.
step_bridges() {
    local inputs=(bridges ':!bridges/*.md')
    unless_stamped bridges "${inputs[@]}"
    install_packages <<<"nats-server nats-server"
    (
        cd bridges
        export CARGO_TARGET_DIR=$CARGO_TARGET_DIR/bridges
        cargo fmt --all --check
        # Without the features that the dependencies of tests add.
        cargo check --workspace --locked
        cargo clippy --workspace --all-targets --locked -- -D warnings
        cargo test --workspace --locked "${slow[@]}"
    )
    stamp bridges "${inputs[@]}"
}

# The server for Foxglove: a workspace of its own.
step_foxglove() {
    local inputs=(sm2-foxglove)
    unless_stamped foxglove "${inputs[@]}"
    (
        cd sm2-foxglove
        export CARGO_TARGET_DIR=$CARGO_TARGET_DIR/foxglove
        cargo fmt --all --check
        # Without the features that the dependencies of tests add.
        cargo check --locked
        cargo clippy --all-targets --locked -- -D warnings
        cargo test --locked
    )
    stamp foxglove "${inputs[@]}"
}

# The page of `sm2 view`, in Chromium. Screenshots go to target/view.
step_view() {
    local inputs=(sm2-cli/browser sm2-cli/examples/fleet.rs sm2-cli/src/web_view)
    unless_stamped view "${inputs[@]}"
    install_packages <<<"chromium chromium"
    sm2-cli/browser/run
    stamp view "${inputs[@]}"
}

# Single changes of the code that the tests have to notice, at drawn places.
step_mutants() {
    local crates=()
    read -ra crates <<<"${SM2_MUTANT_CRATES:-}"
    command -v python3 >/dev/null || skip "needs python3"
    install cargo-mutants || skip "cargo-mutants cannot be built here"
    .ci/mutants "${crates[@]}"
}
