/* CXP1: what each request does. Its definition is docs/cxp1.md. */
#ifndef PROTOCOL_H
#define PROTOCOL_H

#include "frame.h"

enum error { OK, BAD_OP, BAD_LENGTH, OUT_OF_RANGE, WRONG_STATE, DUTY_LIMIT, ON_LIMIT };

/* Obey a request and reply; the request answered last is answered again without being obeyed again. */
void protocol_serve(const struct frame *request);

#endif
