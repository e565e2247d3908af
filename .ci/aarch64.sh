# The step `aarch64`: the tests of the local domain on an emulated processor. Sourced by .ci/run.
#
# The step finds code that is wrong for the alignment, the `cfg`, the system calls or the C code of that processor. It
# does not find a wrong memory order, because QEMU's threads run on the memory of this processor: loom does.

readonly aarch64=aarch64-unknown-linux-gnu
readonly aarch64_packages=(-p sm2-proto -p sm2-io -p sm2-manager -p sm2-node)
# The tests that the emulator cannot run.
readonly aarch64_excluded=.ci/aarch64-excluded.txt
# The folder of the C library of that processor, from the package libc6-dev-arm64-cross.
readonly aarch64_lib=/usr/aarch64-linux-gnu/lib
# All programs use that C library, so they need neither a variable nor a package of the other architecture.
readonly aarch64_link=-Wl,--dynamic-linker=$aarch64_lib/ld-linux-aarch64.so.1,-rpath=$aarch64_lib

# Warnings do not fail this step: the compiler may be Debian's, which has another version than that of the other steps.
step_aarch64() {
    [ "$(uname -sm)" = "Linux x86_64" ] || skip "the emulation is set up for Linux on x86_64"
    local sudo=() excluded=() log=$logs/aarch64-tests.log
    [ "$(id -u)" -eq 0 ] || sudo=(sudo -n)
    find_aarch64_compilers
    start_aarch64_programs
    # Each step is a process, so no other step sees these variables.
    export CARGO_TARGET_DIR=$CARGO_TARGET_DIR/aarch64 CARGO_PROFILE_DEV_DEBUG=0 CARGO_INCREMENTAL=0
    export CC_aarch64_unknown_linux_gnu=aarch64-linux-gnu-gcc
    export CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER=aarch64-linux-gnu-gcc
    export CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_RUSTFLAGS=-Clink-arg=$aarch64_link
    # Emulated code is slow, so it is optimised, and each property is tried with fewer cases: the values matter on every
    # processor, and here only what differs between processors does.
    export CARGO_PROFILE_DEV_OPT_LEVEL=1 PROPTEST_CASES=16
    # Longer time limits: sm2_test_support::SOON.
    export SM2_EMULATED=1
    # The installed programs work on processes of this processor. RUSTFLAGS would replace the flags above.
    unset SM2_INSTALLED RUSTFLAGS
    local of=(--locked --target "$aarch64" "${aarch64_packages[@]}" --no-fail-fast)
    # With the examples, because tests start them.
    cargo test "${of[@]}" --no-run
    # Without the tests in the documentation: rustdoc would link them in another way.
    of+=(--lib --bins --tests)
    exclude_from_aarch64 "${of[@]}"
    run_tests "$log" "${of[@]}" -- --exact "${excluded[@]}"
    passed_tests "$log"
}

# Finds a compiler for Rust, which RUSTC names then, and one for C. Installs what is missing.
find_aarch64_compilers() {
    local rustc=${RUSTC:-rustc}
    has_target "$aarch64" "$rustc" || timeout 120 rustup target add "$aarch64" || true
    if ! has_target "$aarch64" "$rustc"; then
        rustc=/usr/bin/rustc
        has_target "$aarch64" "$rustc" || install_debian_rustc || true
        has_target "$aarch64" "$rustc" ||
            skip "no compiler has the target $aarch64: rustup cannot add it, and Debian's rustc-web cannot be installed"
    fi
    export RUSTC=$rustc
    "$RUSTC" --version
    if ! { command -v aarch64-linux-gnu-gcc && command -v qemu-aarch64-static && [ -e "$aarch64_lib/libc.so" ]; }; then
        apt_install --no-install-recommends gcc-aarch64-linux-gnu libc6-dev-arm64-cross qemu-user-static ||
            skip "cannot be installed here: gcc-aarch64-linux-gnu libc6-dev-arm64-cross qemu-user-static"
    fi
}

# TARGET [COMPILER]: whether the compiler has the standard library for the target.
has_target() {
    [ -d "$("${2:-rustc}" --print target-libdir --target "$1" 2>/dev/null)" ]
}

# Other distributions keep their packages of a second architecture elsewhere: `apt-get update` would fail from then on.
install_debian_rustc() {
    grep -qx ID=debian /etc/os-release && "${sudo[@]}" dpkg --add-architecture arm64 &&
        apt_install --no-install-recommends rustc-web libstd-rust-web-dev:arm64
}

# Lets the kernel start programs of that processor, because tests start further programs of the workspace. Its list of
# emulators ends with the system.
start_aarch64_programs() {
    local binfmt=/proc/sys/fs/binfmt_misc zeros='\x00\x00\x00\x00\x00\x00\x00\x00' program=$logs/aarch64-program
    local magic="\\x7fELF\\x02\\x01\\x01\\x00$zeros\\x02\\x00\\xb7\\x00"
    local mask='\xff\xff\xff\xff\xff\xff\xff\x00\xff\xff\xff\xff\xff\xff\xff\xff\xfe\xff\xff\xff'
    aarch64-linux-gnu-gcc "$aarch64_link" -o "$program" -x c - <<<"int main(void) { return 0; }"
    if "$program" 2>/dev/null; then return; fi
    [ -e "$binfmt/register" ] || "${sudo[@]}" mount -t binfmt_misc none "$binfmt" || true
    printf '%s' ":sm2-aarch64:M::$magic:$mask:$(command -v qemu-aarch64-static):F" |
        "${sudo[@]}" tee "$binfmt/register" >/dev/null || true
    "$program" || skip "the kernel cannot start programs for aarch64: no binfmt_misc, or no right to change it"
}

# OPTION...: reads the list of excluded tests into `excluded`, as options of the test programs. Fails if a name is not
# that of exactly one test, since the options hold for all programs.
exclude_from_aarch64() {
    local tests program test reason wrong=0 log=$logs/aarch64-list.log
    cargo test "$@" -- --list >"$log" 2>&1 || { cat "$log" && false; }
    tests=$(listed_tests "$log")
    while read -r program test reason; do
        [[ -n $program && $program != \#* ]] || continue
        if [ -z "$reason" ] || ! grep -qxF "$program $test" <<<"$tests"; then
            echo "$aarch64_excluded: no such test, or no reason: $program $test"
            wrong=1
        elif [ "$(grep -c " $test\$" <<<"$tests")" -ne 1 ]; then
            echo "$aarch64_excluded: several programs have a test of this name: $test"
            wrong=1
        fi
        excluded+=(--skip "$test")
        echo "$program $test: not on an emulated processor: $reason" >>"$skips"
    done <"$aarch64_excluded"
    return "$wrong"
}

# LOG: the tests in the output of `cargo test -- --list`, as lines `PROGRAM TEST`.
listed_tests() {
    awk '
        /^ +Running / { program = $NF; gsub(/^\(.*\/|-[0-9a-f]+\)$/, "", program) }
        /: test$/ { sub(/: test$/, ""); print program, $0 }
    ' "$1"
}

# LOG: the number of tests that passed, for each program.
passed_tests() {
    awk '
        /^ +Running / { program = $NF; gsub(/^\(.*\/|-[0-9a-f]+\)$/, "", program) }
        /^test result: / { print "aarch64: " program ": " $4 " tests passed" }
    ' "$1"
}
