/* A text of ROS 2, for ros_talker.c and ros_listener.c. */
#ifndef ROS_TEXT_H
#define ROS_TEXT_H

#include "check.h"

static const char TEXT_NAME[] = "std_msgs/msg/String";

/* CDR in little endian: the encapsulation, then the length of the text with its NUL. */
static const unsigned char ENCAPSULATION[4] = {0, 1, 0, 0};
#define TEXT_AT 8

/* Returns the schema text of the type, which sm2_text_free() frees. */
static char *text_schema(void) {
    char *schema;
    CHECK(sm2_ros_schema(TEXT_NAME, NULL, &schema));
    return schema;
}

#endif
