# The step `package`: the packages of `sm2`, built, unpacked in a clean folder and started from there. Sourced by .ci/run.

# Builds a Debian package, a static program and a Debian package for aarch64. Without the target of musl, the Debian
# package is the most portable one: its build states the oldest glibc.
step_package() {
    [ "$(uname -sm)" = "Linux x86_64" ] || skip "the packages are set up for Linux on x86_64"
    local out=$logs/packages
    command -v dpkg-deb >/dev/null || skip "there is no dpkg-deb"
    install_packages <<<"binutils objdump
musl-tools musl-gcc"
    rm -rf "$out"
    packaging/build x86_64-unknown-linux-gnu "$out"
    check_package "$out"/sm2_*_amd64.deb
    # The limit of the length bites.
    if SM2_MAX_PROGRAM_BYTES=1000000 packaging/build x86_64-unknown-linux-gnu "$out/none" 2>"$out/too-long"; then
        echo "a program that is too long is packaged" && false
    fi
    grep -F "more than 1000000" "$out/too-long"
    package_static "$out"
    # It may be skipped for itself. In the background, so that a command that fails ends it.
    local status=0
    package_aarch64 "$out" &
    wait "$!" || status=$?
    [ "$status" -eq 0 ] || [ "$status" -eq "$skipped" ]
}

# OUT: the static program, if the target and its C compiler can be installed.
package_static() {
    local target=x86_64-unknown-linux-musl
    has_target "$target" || timeout 120 rustup target add "$target" || true
    if ! has_target "$target" || ! command -v musl-gcc >/dev/null; then
        echo "no static program: the target $target or musl-gcc is missing"
        return
    fi
    packaging/build "$target" "$1"
    check_package "$1"/sm2-*-linux-static.tar.gz
}

# OUT: the package for aarch64, if its compilers and the emulator can be installed. It is started by the emulator.
package_aarch64() (
    local sudo=()
    [ "$(id -u)" -eq 0 ] || sudo=(sudo -n)
    find_aarch64_compilers
    export CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER=aarch64-linux-gnu-gcc
    export CC_aarch64_unknown_linux_gnu=aarch64-linux-gnu-gcc
    export SM2_RUNNER="qemu-aarch64-static -L ${aarch64_lib%/lib}"
    packaging/build "$aarch64" "$1"
    check_package "$1"/sm2_*_arm64.deb
)

# PACKAGE: unpacks it in a clean folder, and starts its programs there without the variables of this process.
check_package() {
    local package=$1 root run=() word unit
    root=$(mktemp -d)
    read -ra run <<<"${SM2_RUNNER:-}"
    case $package in
        *.deb)
            dpkg-deb --info "$package"
            dpkg-deb --extract "$package" "$root"
            ;;
        *) tar -C "$root" -xzf "$package" ;;
    esac
    run=(env -i "PATH=/usr/bin:/bin" "XDG_RUNTIME_DIR=$root/run" "${run[@]}")
    mkdir -m 700 "$root/run"
    "${run[@]}" "$root/usr/bin/sm2" --version
    "${run[@]}" "$root/usr/bin/sm2" bag --help >/dev/null
    # Under emulation the Manager neither serves nor ends, for a reason that is not known.
    if [ -n "${SM2_RUNNER:-}" ]; then
        echo "skipped: $package is emulated here, so no Manager is started"
    else
        smoke "$root" "${run[@]}"
    fi
    # Each program that a unit starts is in the package, and has the options of the unit.
    for unit in "$root"/usr/lib/systemd/{system,user}/*.service; do
        grep -q '^ExecStart=/usr/bin/' "$unit"
        while read -r word _; do [ -x "$root$word" ] || { echo "$unit: no $word" && false; }; done \
            < <(sed -nE 's/^Exec(Start|Reload)=(\/usr\/.*)/\2/p' "$unit")
    done
    # systemd reads the units as they are in the package, with the paths of its programs there. One of a template needs
    # an instance.
    if command -v systemd-analyze >/dev/null; then
        mkdir "$root/units"
        for unit in "$root"/usr/lib/systemd/system/*; do
            word=$(basename "$unit")
            sed "s#/usr/bin/sm2#$root&#" "$unit" >"$root/units/${word/@/@arm}"
        done
        systemd-analyze verify --man=no "$root"/units/*.service
    fi
    for word in share/man/man1/sm2-topic-hz.1.gz share/bash-completion/completions/sm2 share/doc/sm2/copyright; do
        [ -s "$root/usr/$word" ] || { echo "$package: no usr/$word" && false; }
    done
    rm -rf "$root"
}

# ROOT COMMAND...: a Manager, a publisher and a subscriber, started by their names in the package, and a gateway's key.
smoke() {
    local root=$1 bin=$1/usr/bin manager echo status=0
    shift
    # `timeout` passes SIGTERM on, and kills 60 s after it.
    timeout --kill-after=60 300 "$@" "$bin/sm2-manager" --domain packaged >"$root/manager.log" 2>&1 &
    manager=$!
    timeout 120 "$@" "$bin/sm2" topic echo chatter --domain packaged --wait-manager 60s --count 1 >"$root/echo.log" 2>&1 &
    echo=$!
    "$@" "$bin/sm2" topic pub chatter --value '"from the package"' --type text --domain packaged --wait-manager 60s ||
        status=$?
    [ "$status" -eq 0 ] || kill "$echo" 2>/dev/null || true
    wait "$echo" || status=$?
    kill -TERM "$manager"
    wait "$manager" || status=$?
    "$@" "$bin/sm2-gateway" keygen "$root/key" || status=$?
    if [ "$status" -ne 0 ] || ! grep -F "from the package" "$root/echo.log"; then
        cat "$root/manager.log" "$root/echo.log"
        false
    fi
}
