//! Compiles the libraries of the DDS peers.

use std::{
    env, fs,
    hash::{DefaultHasher, Hash, Hasher},
    path::{Path, PathBuf},
    process::Command,
};

const HEADER: &str = include_str!("../../../dds/bench_dds.h");

/// The source of a library, and the command that compiles it.
struct Recipe {
    file: &'static str,
    source: &'static str,
    compiler: &'static str,
    arguments: &'static [&'static str],
    packages: &'static str,
}

fn recipe(vendor: &str) -> Option<Recipe> {
    match vendor {
        "cyclone" => Some(Recipe {
            file: "cyclone.c",
            source: include_str!("../../../dds/cyclone.c"),
            compiler: "cc",
            arguments: &["-std=c11", "-lddsc"],
            packages: "gcc libc6-dev cyclonedds-dev",
        }),
        "fastdds" => Some(Recipe {
            file: "fastdds.cpp",
            source: include_str!("../../../dds/fastdds.cpp"),
            compiler: "c++",
            arguments: &["-std=c++17", "-lfastrtps", "-lfastcdr"],
            packages: "g++ libfastrtps-dev libfastcdr-dev",
        }),
        "sm2" => Some(Recipe {
            file: "sm2.cpp",
            source: include_str!("../../../dds/sm2.cpp"),
            compiler: "c++",
            arguments: &[
                "-std=c++17",
                concat!("-I", env!("CARGO_MANIFEST_DIR"), "/../sm2-cpp/include"),
                concat!("-I", env!("CARGO_MANIFEST_DIR"), "/../sm2-c/include"),
                concat!(env!("CARGO_MANIFEST_DIR"), "/../target/c/release/libsm2.a"),
                "-lpthread",
                "-ldl",
                "-lm",
            ],
            packages: "g++` and `cargo build --release --manifest-path ../sm2-c/Cargo.toml --target-dir ../target/c",
        }),
        _ => None,
    }
}

/// The compiled library of this vendor, in a folder beside this program. Compiled on first use.
///
/// # Errors
///
/// The reason why it cannot be compiled, and the packages that it needs.
pub(super) fn built(vendor: &str) -> Result<PathBuf, String> {
    let recipe = recipe(vendor).ok_or_else(|| format!("there is no library for {vendor}"))?;
    let program = env::current_exe().map_err(|error| error.to_string())?;
    let dir = program.with_file_name("sm2-bench-dds");
    let mut hasher = DefaultHasher::new();
    (HEADER, recipe.source, recipe.arguments).hash(&mut hasher);
    let path = dir.join(format!("lib{vendor}-{:016x}.so", hasher.finish()));
    if path.exists() {
        return Ok(path);
    }
    compile(&recipe, &dir, &path)
        .map_err(|reason| format!("{reason}; needs `apt-get install {}`", recipe.packages))?;
    Ok(path)
}

fn compile(recipe: &Recipe, dir: &Path, path: &Path) -> Result<(), String> {
    eprintln!("compiling {}", recipe.file);
    let text = |error: std::io::Error| error.to_string();
    fs::create_dir_all(dir).map_err(text)?;
    let source = dir.join(recipe.file);
    fs::write(dir.join("bench_dds.h"), HEADER).map_err(text)?;
    fs::write(&source, recipe.source).map_err(text)?;
    // Another run may compile the same library; both put the same file in place.
    let unfinished = path.with_extension(std::process::id().to_string());
    let output = Command::new(recipe.compiler)
        .args(["-O2", "-fPIC", "-shared", "-o"])
        .args([&unfinished, &source])
        .args(recipe.arguments)
        .output()
        .map_err(|error| format!("{}: {error}", recipe.compiler))?;
    if !output.status.success() {
        let text = String::from_utf8_lossy(&output.stderr);
        let line = text.lines().find(|line| line.contains("error"));
        return Err(line.unwrap_or("it does not compile").to_owned());
    }
    fs::rename(unfinished, path).map_err(text)
}

#[cfg(test)]
mod tests {
    use super::{Recipe, built, compile};

    #[test]
    fn what_does_not_compile_is_told_with_the_compilers_word() {
        let dir = tempfile::tempdir().unwrap();
        let recipe = Recipe {
            file: "wrong.c",
            source: "#include <no_such_header.h>\n",
            compiler: "cc",
            arguments: &[],
            packages: "",
        };
        let path = dir.path().join("wrong.so");
        let reason = compile(&recipe, dir.path(), &path).unwrap_err();
        assert!(reason.contains("no_such_header.h"), "{reason}");
        assert!(!path.exists());
    }

    #[test]
    fn a_compiler_that_is_not_there_is_named() {
        let dir = tempfile::tempdir().unwrap();
        let recipe = Recipe {
            file: "some.c",
            source: "",
            compiler: "no-such-compiler",
            arguments: &[],
            packages: "",
        };
        let reason = compile(&recipe, dir.path(), &dir.path().join("some.so")).unwrap_err();
        assert!(reason.starts_with("no-such-compiler: "), "{reason}");
    }

    #[test]
    fn only_known_vendors_have_libraries() {
        assert!(built("nobody").is_err());
    }
}
