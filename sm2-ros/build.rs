//! Generates the types of ROS 2's common interfaces, with the feature `common-interfaces`.

#[cfg(feature = "common-interfaces")]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut builder = sm2_ros_build::Builder::new().common_interfaces(false);
    for entry in std::fs::read_dir("definitions")? {
        let path = entry?.path();
        if path.is_dir() {
            builder = builder.package(path);
        }
    }
    println!("cargo:rerun-if-changed=definitions");
    Ok(builder.generate()?)
}

#[cfg(not(feature = "common-interfaces"))]
fn main() {
    println!("cargo:rerun-if-changed=build.rs");
}
