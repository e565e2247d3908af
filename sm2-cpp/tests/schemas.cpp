// Schema texts of all kinds of messages.
#include "check.hpp"
#include "messages.hpp"

namespace {

// A struct with the most fields.
struct Wide {
    std::uint8_t a1, a2, a3, a4, a5, a6, a7, a8, b1, b2, b3, b4, b5, b6, b7, b8;
    std::uint8_t c1, c2, c3, c4, c5, c6, c7, c8, d1, d2, d3, d4, d5, d6, d7, d8;
};

struct Narrow {
    std::int64_t only;
};

template <typename T>
void is(const char* name, const char* schema) {
    const sm2_type_t* type = sm2::Message<T>::type();
    CHECK(type->size == sizeof *type);
    CHECK(std::string(type->name) == name);
    CHECK(std::string(type->schema) == schema);
    std::uint64_t hash = 0;
    CHECK(sm2_schema_hash(type->schema, &hash) == SM2_OK);
    CHECK(hash != 0);
}

}  // namespace

SM2_STRUCT(Wide, "test/Wide", a1, a2, a3, a4, a5, a6, a7, a8, b1, b2, b3, b4, b5, b6, b7, b8, c1, c2,
           c3, c4, c5, c6, c7, c8, d1, d2, d3, d4, d5, d6, d7, d8);
SM2_STRUCT(Narrow, "test/Narrow", only);

int main() {
    is<robot::Vector>("robot/Vector", "plain:struct{x:f64,y:f64,z:f64,}");
    is<robot::Imu>("robot/Imu",
                   "plain:struct{stamp_ns:u64,acceleration:struct{x:f64,y:f64,z:f64,},"
                   "orientation:array[f32;0000000000000004],temperature:array[i16;0000000000000003],"
                   "state:u8,padding:u8,}");
    is<robot::Vector[]>("robot/Vector-list", "plain:list[struct{x:f64,y:f64,z:f64,}]");
    is<Narrow>("test/Narrow", "plain:struct{only:i64,}");
    is<std::uint8_t>("u8", "plain:u8");
    is<std::int8_t>("i8", "plain:i8");
    is<std::uint16_t>("u16", "plain:u16");
    is<std::int32_t>("i32", "plain:i32");
    is<long long>("i64", "plain:i64");
    is<unsigned long>("u64", "plain:u64");
    is<float>("f32", "plain:f32");
    is<double[]>("f64-list", "plain:list[f64]");
    is<std::string>("text", "plain:string");
    CHECK(sm2::Message<std::byte[]>::type() == nullptr);
    CHECK(sm2::Message<std::uint8_t[]>::type() == nullptr);
    const std::string wide = sm2::Message<Wide>::type()->schema;
    CHECK(has(wide, "struct{a1:u8,a2:u8,") && has(wide, ",d8:u8,}"));
    return 0;
}
