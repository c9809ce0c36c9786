<% for line in comment %>
// ${line}
<% endfor %>
const ${name} = (function () {
    "use strict";
<% for helper in helpers %>
    ${helper | indent}
<% endfor %>
    function defaults() {
        const self = {
<% for structure in structures %>
            ${structure},
<% endfor %>
            prepared: {real: [], integer: [], boolean: []},
        };
        prepare(self);
        return self;
    }

    function prepare(self) {
    <% for line in prepare %>
    ${line}
    <% endfor %>
    }

<% for function in functions %>
    // ${function.function.text}
    function ${function.name}(${function.arguments}) {
    <% set guard = function.function.guard %>
    <% if guard | length == 1 %>
        ${guard[0].call};
    <% elif guard %>
        const action = ${guard[1].call};
        if (action === 1) return ${guard[2].name}(self);
        if (action === 2) ${guard[0].call};
    <% endif %>
    <% for line in function.lines %>
    ${line}
    <% endfor %>
    }

<% endfor %>
    return {${(["defaults", "prepare"] + functions | map(attribute="name") | list) | join(", ")}};
})();
if (typeof module !== "undefined") module.exports = ${name};
