/* Ends an example when a call fails. */
#ifndef CHECK_H
#define CHECK_H

#include <stdio.h>
#include <stdlib.h>

#include "sm2.h"

/* Prints the error of a call and ends the program, unless the call returned SM2_OK. */
#define CHECK(call)                                                                                \
    do {                                                                                           \
        sm2_status_t status_ = (call);                                                             \
        if (status_ != SM2_OK) {                                                                   \
            fprintf(stderr, "%s: %s: %s\n", #call, sm2_status_name(status_), sm2_last_error());    \
            exit(1);                                                                               \
        }                                                                                          \
    } while (0)

/* A second in nanoseconds. */
#define SECOND_NS UINT64_C(1000000000)

#endif
