/* A message type of the examples. */
#ifndef POSE_H
#define POSE_H

#include "sm2.h"

typedef struct pose {
    double x;
    double y;
    double heading;
} pose_t;

/* Another program has the same type if its name and schema are the same, in any language. */
static const sm2_type_t POSE_TYPE = {
    .size = sizeof(sm2_type_t),
    .name = "demo/Pose",
    .schema = "plain:struct{x:f64,y:f64,heading:f64,}",
    .hash = 0,
};

#endif
