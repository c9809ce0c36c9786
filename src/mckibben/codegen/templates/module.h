${comment}
#ifndef ${name | upper}_H
#define ${name | upper}_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

<% for structure in structures %>
<% if structure.text %>
/* ${structure.text} */
<% endif %>
typedef struct {
<% for line in structure.lines %>
    ${line}
<% endfor %>
} ${structure.name};

<% endfor %>
/* set the default parameters, and prepare */
void ${name}_defaults(${name} *self);

/* call after changing parameters */
void ${name}_prepare(${name} *self);

<% for function in functions %>
/* ${function.function.text} */
${function.signature};

<% endfor %>
#ifdef __cplusplus
}
#endif

#endif
