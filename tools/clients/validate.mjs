// What Khronos's validator says of a .glb: node validate.mjs FILE, beside node_modules. Status 1 for errors.
// It does not know KHR_gaussian_splatting, and says of each name that the extension prescribes that it is none.
import { readFileSync } from "node:fs";
import validator from "gltf-validator";

const { issues } = await validator.validateBytes(new Uint8Array(readFileSync(process.argv[2])));
const prescribed = ({ code, pointer }) =>
  code === "UNSUPPORTED_EXTENSION" || (code === "MESH_PRIMITIVE_INVALID_ATTRIBUTE" && pointer.includes("/KHR_gaussian_splatting:"));
const others = issues.messages.filter(message => !prescribed(message));
console.log(JSON.stringify({ unknown: issues.messages.length - others.length, others: [...new Set(others.map(({ code }) => code))] }));
process.exit(others.some(({ severity }) => severity === 0) ? 1 : 0);
