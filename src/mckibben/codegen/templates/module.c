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
<% set guard = function.function.guard %>
<% if guard | length == 1 %>
    ${name}_${guard[0].call};
<% elif guard %>
    switch (${name}_${guard[1].call}) {
    case 1:
        ${name}_${guard[2].name}(self, ${function.function.outputs | join(", ")});
        return;
    case 2:
        ${name}_${guard[0].call};
    }
<% endif %>
<% for line in function.lines %>
${line}
<% endfor %>
}
<% endfor %>
