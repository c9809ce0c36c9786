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
    // ${function.text}
    function ${function.name}(${function.arguments}) {
    <% for line in function.lines %>
    ${line}
    <% endfor %>
    }

<% endfor %>
    return {${(["defaults", "prepare"] + functions | map(attribute="name") | list) | join(", ")}};
})();
if (typeof module !== "undefined") module.exports = ${name};
