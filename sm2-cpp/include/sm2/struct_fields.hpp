// Repeats a macro for each field of a struct: the preprocessor of C++17 has no loop.
#ifndef SM2_STRUCT_FIELDS_HPP
#define SM2_STRUCT_FIELDS_HPP

// Calls each(Type, field) for 1 to 32 fields.
#define SM2_FOR_EACH_FIELD(each, Type, ...) \
    SM2_JOIN(SM2_FIELDS_, SM2_COUNT(__VA_ARGS__))(each, Type, __VA_ARGS__)

#define SM2_JOIN(a, b) SM2_JOIN_EXPANDED(a, b)
#define SM2_JOIN_EXPANDED(a, b) a##b
#define SM2_COUNT(...) \
    SM2_COUNT_PICK(__VA_ARGS__, \
    32, 31, 30, 29, 28, 27, 26, 25, 24, 23, 22, 21, 20, 19, 18, 17, 16, 15, 14, 13, 12, 11, \
    10, 9, 8, 7, 6, 5, 4, 3, 2, 1, 0)
#define SM2_COUNT_PICK(_1, _2, _3, _4, _5, _6, _7, _8, _9, _10, _11, _12, _13, _14, _15, _16, \
                       _17, _18, _19, _20, _21, _22, _23, _24, _25, _26, _27, _28, _29, _30, \
                       _31, _32, count, ...) \
    count

#define SM2_FIELDS_1(each, Type, field) each(Type, field)
#define SM2_FIELDS_2(each, Type, field, ...) \
    each(Type, field) SM2_FIELDS_1(each, Type, __VA_ARGS__)
#define SM2_FIELDS_3(each, Type, field, ...) \
    each(Type, field) SM2_FIELDS_2(each, Type, __VA_ARGS__)
#define SM2_FIELDS_4(each, Type, field, ...) \
    each(Type, field) SM2_FIELDS_3(each, Type, __VA_ARGS__)
#define SM2_FIELDS_5(each, Type, field, ...) \
    each(Type, field) SM2_FIELDS_4(each, Type, __VA_ARGS__)
#define SM2_FIELDS_6(each, Type, field, ...) \
    each(Type, field) SM2_FIELDS_5(each, Type, __VA_ARGS__)
#define SM2_FIELDS_7(each, Type, field, ...) \
    each(Type, field) SM2_FIELDS_6(each, Type, __VA_ARGS__)
#define SM2_FIELDS_8(each, Type, field, ...) \
    each(Type, field) SM2_FIELDS_7(each, Type, __VA_ARGS__)
#define SM2_FIELDS_9(each, Type, field, ...) \
    each(Type, field) SM2_FIELDS_8(each, Type, __VA_ARGS__)
#define SM2_FIELDS_10(each, Type, field, ...) \
    each(Type, field) SM2_FIELDS_9(each, Type, __VA_ARGS__)
#define SM2_FIELDS_11(each, Type, field, ...) \
    each(Type, field) SM2_FIELDS_10(each, Type, __VA_ARGS__)
#define SM2_FIELDS_12(each, Type, field, ...) \
    each(Type, field) SM2_FIELDS_11(each, Type, __VA_ARGS__)
#define SM2_FIELDS_13(each, Type, field, ...) \
    each(Type, field) SM2_FIELDS_12(each, Type, __VA_ARGS__)
#define SM2_FIELDS_14(each, Type, field, ...) \
    each(Type, field) SM2_FIELDS_13(each, Type, __VA_ARGS__)
#define SM2_FIELDS_15(each, Type, field, ...) \
    each(Type, field) SM2_FIELDS_14(each, Type, __VA_ARGS__)
#define SM2_FIELDS_16(each, Type, field, ...) \
    each(Type, field) SM2_FIELDS_15(each, Type, __VA_ARGS__)
#define SM2_FIELDS_17(each, Type, field, ...) \
    each(Type, field) SM2_FIELDS_16(each, Type, __VA_ARGS__)
#define SM2_FIELDS_18(each, Type, field, ...) \
    each(Type, field) SM2_FIELDS_17(each, Type, __VA_ARGS__)
#define SM2_FIELDS_19(each, Type, field, ...) \
    each(Type, field) SM2_FIELDS_18(each, Type, __VA_ARGS__)
#define SM2_FIELDS_20(each, Type, field, ...) \
    each(Type, field) SM2_FIELDS_19(each, Type, __VA_ARGS__)
#define SM2_FIELDS_21(each, Type, field, ...) \
    each(Type, field) SM2_FIELDS_20(each, Type, __VA_ARGS__)
#define SM2_FIELDS_22(each, Type, field, ...) \
    each(Type, field) SM2_FIELDS_21(each, Type, __VA_ARGS__)
#define SM2_FIELDS_23(each, Type, field, ...) \
    each(Type, field) SM2_FIELDS_22(each, Type, __VA_ARGS__)
#define SM2_FIELDS_24(each, Type, field, ...) \
    each(Type, field) SM2_FIELDS_23(each, Type, __VA_ARGS__)
#define SM2_FIELDS_25(each, Type, field, ...) \
    each(Type, field) SM2_FIELDS_24(each, Type, __VA_ARGS__)
#define SM2_FIELDS_26(each, Type, field, ...) \
    each(Type, field) SM2_FIELDS_25(each, Type, __VA_ARGS__)
#define SM2_FIELDS_27(each, Type, field, ...) \
    each(Type, field) SM2_FIELDS_26(each, Type, __VA_ARGS__)
#define SM2_FIELDS_28(each, Type, field, ...) \
    each(Type, field) SM2_FIELDS_27(each, Type, __VA_ARGS__)
#define SM2_FIELDS_29(each, Type, field, ...) \
    each(Type, field) SM2_FIELDS_28(each, Type, __VA_ARGS__)
#define SM2_FIELDS_30(each, Type, field, ...) \
    each(Type, field) SM2_FIELDS_29(each, Type, __VA_ARGS__)
#define SM2_FIELDS_31(each, Type, field, ...) \
    each(Type, field) SM2_FIELDS_30(each, Type, __VA_ARGS__)
#define SM2_FIELDS_32(each, Type, field, ...) \
    each(Type, field) SM2_FIELDS_31(each, Type, __VA_ARGS__)

#endif
