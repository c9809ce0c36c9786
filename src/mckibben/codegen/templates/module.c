${comment}
#include "${name}.h"

#include <math.h>
#include <string.h>

<% for helper in helpers %>
${helper}
<% endfor %>
void ${name}_defaults(${name} *self)
{
<% for place, number in defaults %>
    self->${place} = ${number};
<% endfor %>
    ${name}_prepare(self);
}

void ${name}_prepare(${name} *self)
{
<% for line in prepare %>
${line}
<% endfor %>
}
<% for function in functions %>

${function.signature}
{
<% for line in function.lines %>
${line}
<% endfor %>
}
<% endfor %>
